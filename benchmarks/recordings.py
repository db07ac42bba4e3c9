"""Recordings: what writing costs at the flight's rates, how fast a long session is read, reported and run again.

The session is one flight on virtual time, said again and again until it is as long as asked (10 minutes). Beside ours the
bare `mcap` writer and reader and foxglove-sdk's writer, on the same bytes. Writing is given as the share of a core that
the flight's own rates would take, and by how much those rates could rise. Then the recorder as the process that it is, over
Zenoh: everything that the flight said, said again at its own pace and at ten times that.
`python -m benchmarks.recordings [minutes]`
"""

import asyncio
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import foxglove
from mcap.reader import make_reader
from mcap.writer import Writer
from pydantic_core import from_json, to_json

from benchmarks.table import show
from schemas.topics import BY_KEY, HEALTH, TOPICS
from services.config import load
from services.console.replay import spoken
from services.console.start import bus_config, launch_all
from services.recorder import Session
from services.recorder.page import write_page
from services.recorder.rerun import rerun
from services.recorder.rerun_subjects import SUBJECTS
from services.recorder.schema import json_schema, schema_text
from services.recorder.service import LOGGED
from services.recorder.walk import CONFIG_ATTACHMENT
from services.recorder.writer import SessionWriter, channel_name
from services.rehearsal.chain import whole
from services.runtime.zenoh_bus import open_bus
from tests.services.chain import fly

WRITING = ("writer", "messages", "CPU s", "µs a message", "share of a core %", "x the flight's rates")
LISTENING = ("over Zenoh", "said /s", "said", "kept", "lost", "recorder CPU %")
READING = ("what", "s", "session s", "x real time")
CHUNK_bytes = 65_536

Said = list[tuple[int, str, bytes]]
"""Wall-clock time, topic and bytes."""


def flight(folder: Path) -> Session:
    """One demo on virtual time, with its recording."""
    fly(load("demo"), whole, record=folder / "flight.mcap")
    return Session(folder / "flight.mcap")


def stretched(session: Session, length_s: float) -> Said:
    """The flight over and over; seq, stamps and what they name go on rising."""
    once = [(round(t_s * 1e9), key, from_json(payload)) for t_s, key, payload in spoken(session)]
    last_seq = {key: log_seq(rows) for key, rows in _by_key(once).items()}
    period_ns, said = round(session.duration_s * 1e9) + 10_000_000, Said()
    for n in range(round(length_s / session.duration_s + 0.5)):
        shift_ns = n * period_ns
        for time_ns, key, row in once:
            inputs = {k: v + n * last_seq.get(k, 0) for k, v in row["inputs"].items()}
            header = {
                "seq": row["seq"] + n * last_seq[key],
                "stamp_ns": row["stamp_ns"] + shift_ns,
                "said_ns": row["said_ns"] + shift_ns,
                "inputs": inputs,
            }
            said.append((session.start_ns + time_ns + shift_ns, key, to_json({**row, **header})))
    return said


def _by_key(once: Sequence[tuple[int, str, dict[str, int]]]) -> dict[str, list[dict[str, int]]]:
    found: dict[str, list[dict[str, int]]] = {}
    for _, key, row in once:
        found.setdefault(key, []).append(row)
    return found


def log_seq(rows: Sequence[dict[str, int]]) -> int:
    """The last seq of a topic."""
    return max(row["seq"] for row in rows)


def ours(said: Said, file: Path) -> None:
    """As the recorder writes."""
    config = load("demo").model_dump_json().encode()
    stamps = from_json(said[0][2])["stamp_ns"]
    with SessionWriter(
        file,
        TOPICS,
        epoch_ns=said[0][0] - stamps,
        chunk_bytes=CHUNK_bytes,
        metadata={"format": "2"},
        attachments={CONFIG_ATTACHMENT: config},
    ) as writer:
        for n, (time_ns, key, payload) in enumerate(said):
            writer.add(key, payload, time_ns - said[0][0] + stamps)
            if n % 220 == 0:  # five times a second at the flight's rates
                writer.flush()


def bare(said: Said, file: Path) -> None:
    """The mcap library by itself."""
    with file.open("wb") as stream:
        writer = Writer(stream, chunk_size=CHUNK_bytes)
        writer.start()
        ids = {
            key: writer.register_channel(
                channel_name(key), "json", writer.register_schema(key, "jsonschema", schema_text(topic.type))
            )
            for key, topic in BY_KEY.items()
        }
        for n, (time_ns, key, payload) in enumerate(said):
            writer.add_message(ids[key], time_ns, payload, time_ns, n)
        writer.finish()


def foxgloves(said: Said, file: Path) -> None:
    """foxglove-sdk's writer, with its own size of chunks."""
    context = foxglove.Context()
    with foxglove.open_mcap(file, context=context):
        channels = {
            key: foxglove.Channel(channel_name(key), schema=json_schema(topic.type), context=context)
            for key, topic in BY_KEY.items()
        }
        for time_ns, key, payload in said:
            channels[key].log(payload, log_time=time_ns)


def writing(said: Said, folder: Path) -> list[tuple[str, ...]]:
    """A row for each writer."""
    length_s = (said[-1][0] - said[0][0]) * 1e-9
    rows: list[tuple[str, ...]] = []
    writers: dict[str, Callable[[Said, Path], None]] = {"ours": ours, "mcap": bare, "foxglove-sdk": foxgloves}
    for name, write in writers.items():
        began = time.process_time()
        write(said, folder / f"{name}.mcap")
        cpu_s = time.process_time() - began
        rows.append(
            (name, str(len(said)), f"{cpu_s:.2f}", f"{1e6 * cpu_s / len(said):.1f}", f"{100 * cpu_s / length_s:.2f}",
             f"{length_s / cpu_s:.0f}")
        )  # fmt: skip
    return rows


def listening(session: Session, speed: float) -> tuple[str, ...]:
    """One row: a recorder in a process of its own, and one that says the whole flight `speed` times as fast."""
    own = HEALTH["recorder"].key
    logged = {topic.key for topic in LOGGED} - {own}
    said = [(t_s, key, payload) for t_s, key, payload in spoken(session) if key in logged]
    with tempfile.TemporaryDirectory() as folder:
        config = load("demo", session_dir=folder)
        config = config.model_copy(
            update={"system": replace(config.system, name="bench_recordings", services=("recorder",))}
        )

        async def say() -> None:
            async with launch_all(config):
                with open_bus(replace(bus_config(config), services=("recorder", "simulator")), "simulator") as bus:
                    await asyncio.sleep(1.0)  # until the links are up
                    began = time.monotonic()
                    for t_s, key, payload in said:
                        if (wait := began + t_s / speed - time.monotonic()) > 1e-3:
                            await asyncio.sleep(wait)
                        bus.put(key, payload, BY_KEY[key].stance)
                    await asyncio.sleep(0.5)

        asyncio.run(say())
        heard = Session(Path(folder, "session.mcap"))
        counts = {key: count for key, count in heard.verdict.topics.items() if key in logged}
        kept = sum(count.received for count in counts.values())
        cpu = heard.table(HEALTH["recorder"])["cpu_fraction"][4:-1].mean()
    rate = len(said) / session.duration_s * speed
    return (f"{speed:g} x", f"{rate:.0f}", str(len(said)), str(kept), str(len(said) - kept), f"{100 * cpu:.1f}")


def reading(file: Path, folder: Path) -> list[tuple[str, ...]]:
    """A row for each thing that is done with a finished recording."""
    acts: dict[str, Callable[[], object]] = {
        "mcap: every message, not parsed": lambda: _pass_over(file),
        "one topic into arrays": lambda: Session(file).handle.position_m,
        "all topics into arrays": lambda: Session(file).prepare(*TOPICS),
        "the report's page": lambda: write_page([Session(file)], folder / "report.html"),
    }
    length_s = Session(file).duration_s
    return [_timed(name, act, length_s) for name, act in acts.items()]


def _pass_over(file: Path) -> int:
    with file.open("rb") as stream:
        return sum(1 for _ in make_reader(stream).iter_messages())


def rerunning(session: Session) -> list[tuple[str, ...]]:
    """A row for each service, on the flight itself."""
    config, rows = load("demo"), list[tuple[str, ...]]()
    for name in SUBJECTS:
        outcome = rerun(session, name, config)
        said = "equal" if outcome.equal else "DIFFERS"
        rows.append(
            (f"rerun {name}: {said}", f"{outcome.took_s:.2f}", f"{outcome.recorded_s:.0f}",
             f"{outcome.recorded_s / outcome.took_s:.0f}")
        )  # fmt: skip
    return rows


def _timed(name: str, act: Callable[[], object], length_s: float) -> tuple[str, ...]:
    began = time.perf_counter()
    act()
    took_s = time.perf_counter() - began
    return (name, f"{took_s:.2f}", f"{length_s:.0f}", f"{length_s / took_s:.0f}")


def run(minutes: float = 10.0) -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        session = flight(folder)
        said = stretched(session, 60.0 * minutes)
        show(writing(said, folder), WRITING)
        del said
        show([listening(session, speed) for speed in (1.0, 10.0)], LISTENING)
        show([*reading(folder / "ours.mcap", folder), *rerunning(session)], READING)


if __name__ == "__main__":
    run(float(sys.argv[1]) if len(sys.argv) > 1 else 10.0)
