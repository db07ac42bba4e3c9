"""kill -9 of the recorder at random instants: little is lost, the rest can be read, and nobody else notices.

CLEW_KILLS sets how often, 10 by default.
"""

import asyncio
import json
import multiprocessing
import os
import random
import signal
import sys
import time

from schemas.topics import GUIDANCE
from services.config import load
from services.recorder.reading import read
from services.recorder.recovery import recover
from services.runtime.bus_config import BusConfig
from services.runtime.process import serve
from services.runtime.zenoh_bus import open_bus

KILLS = int(os.environ.get("CLEW_KILLS", "10"))
RATE_HZ = 200.0
LOST_MAX_S = 0.5
SLOW_S = 0.1  # a put that took as long as this was blocked; the machine itself may be late by less


def bus_config(run_dir) -> BusConfig:
    return BusConfig(system="killed", run_dir=str(run_dir), services=("recorder", "guiding_controller"))


def record(run_dir, folder) -> None:
    """The recorder as it runs in a system."""
    from services.recorder import service

    config = load("demo", session_dir=str(folder))
    sys.exit(serve("recorder", service.run, config, bus_config(run_dir)))


def payload(seq: int) -> bytes:
    return b'{"seq":%d,"stamp_ns":%d,"filler":"%s"}' % (seq, time.monotonic_ns(), os.urandom(150).hex().encode())


async def live(run_dir, folders, instants):
    """Speak at a steady rate while one recorder after another is killed.

    What was said when each died, the longest put, and what a neighbour heard.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["services.recorder.service", "services.config"])
    said, heard, slowest, at_death = 0, [], 0.0, []
    config = bus_config(run_dir)
    with open_bus(config, "guiding_controller") as mouth, open_bus(config, "neighbour") as ear:
        ear.subscribe(GUIDANCE.key, lambda _, payload: heard.append(json.loads(payload)["seq"]))
        await asyncio.sleep(0.3)
        for folder, instant in zip(folders, instants, strict=True):
            recorder = context.Process(target=record, args=(run_dir, folder))
            recorder.start()
            due, end, grown = time.monotonic(), float("inf"), 0.0
            while time.monotonic() < end:
                said += 1
                began = time.monotonic()
                mouth.put(GUIDANCE.key, payload(said), GUIDANCE.stance)
                slowest = max(slowest, time.monotonic() - began)
                if not grown and (folder / "session.mcap").exists():
                    grown, end = time.monotonic(), time.monotonic() + instant
                due += 1.0 / RATE_HZ
                await asyncio.sleep(max(0.0, due - time.monotonic()))
            assert recorder.pid
            os.kill(recorder.pid, signal.SIGKILL)
            at_death.append(time.monotonic_ns())
            recorder.join()
        await asyncio.sleep(0.2)
    return at_death, slowest, said, heard


def test_little_is_lost_and_nobody_notices(tmp_path):
    chance = random.Random(KILLS)
    folders = [tmp_path / f"s{n}" for n in range(KILLS)]
    for folder in folders:
        folder.mkdir()
    instants = [chance.uniform(0.4, 1.2) for _ in folders]
    at_death, slowest, said, heard = asyncio.run(live(tmp_path / "run", folders, instants))
    for folder, died_ns in zip(folders, at_death, strict=True):
        session = read(folder / "session.mcap")
        kept = [json.loads(one) for one in session.logs[GUIDANCE.key].payloads]
        assert "cut off" in session.damage
        assert [m["seq"] for m in kept] == list(range(kept[0]["seq"], kept[-1]["seq"] + 1))
        assert (died_ns - kept[-1]["stamp_ns"]) * 1e-9 < LOST_MAX_S
        assert recover(session, folder / "recovered.mcap") == len(kept) + len(
            session.logs.get("health/recorder", ([], []))[0]
        )
        assert read(folder / "recovered.mcap").damage == ""
    assert slowest < SLOW_S
    assert heard == list(range(heard[0], said + 1))  # no gap, all the way
