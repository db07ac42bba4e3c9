"""One hop at 1 kHz: from publish in one process to the message in the other process's loop, beside bare Zenoh bytes.

- bare: `put(bytes)` on a declared publisher -> Zenoh's callback in the other process has the bytes. No model, no loop.
- loop: the same bytes -> the other process's loop has them, by the shortest way that asyncio knows.
- decoded: `publish(HandleState)` called -> decoded and checked in the other process's loop, where a Latest holds it.
- stream: the same call -> the service's `async for` over a Stream has it.
- turn: the sender's turn began (its `said_ns`) -> the same: with the sender's heartbeat and the making of the message.

All have the same session settings, QoS and size; bare and ours take turns of 250 ms within one run and so meet the same
load. Stamps are CLOCK_MONOTONIC, one clock for all processes of a host. `python -m benchmarks.hop`
"""

# Zenoh's stubs leave some return types open.
# pyright: reportUnknownMemberType=false

import asyncio
import json
import sys
import tempfile
import time
from collections import deque
from collections.abc import AsyncIterator, Sequence
from pathlib import Path

import zenoh

from benchmarks.table import quantile_ms, show
from schemas.message import Vec3
from schemas.topics import HANDLE_STATE, SERVICES, Stance
from schemas.tracking import HandleSource, HandleState
from services.runtime.bus import Mailbox, OnPayload
from services.runtime.bus_config import BusConfig
from services.runtime.clock import MonotonicClock
from services.runtime.node import Node
from services.runtime.zenoh_bus import ZenohBus, open_bus, session_config

COLUMNS = ("one hop", "p50 ms", "p99 ms", "/bare p50", "p99", "/loop p50", "p99", "seen", "sent")

_RATE_Hz, _TURN_ticks, _SIZE_bytes = 1000.0, 250, 290
_BARE_KEY = "bench/bare"


def run(seconds: float = 10.0) -> list[tuple[str, ...]]:
    """Rows under COLUMNS; the first is bare Zenoh."""
    receiver = Receiver()
    with tempfile.TemporaryDirectory() as run_dir:
        asyncio.run(receiver.receive(run_dir, seconds))
    sent = round(seconds * _RATE_Hz / 2)
    bare, loop = (receiver.delays_ns[name] for name in ("bare", "loop"))
    return [_row(name, delays, bare, loop, sent) for name, delays in receiver.delays_ns.items()]


class Receiver:
    """The other process, and the clock at each stage of what it receives."""

    def __init__(self) -> None:
        self.delays_ns: dict[str, list[int]] = {name: [] for name in ("bare", "loop", "decoded", "stream", "turn")}
        self._decoded_ns: deque[int] = deque()
        self._seen: list[tuple[HandleState, int, int]] = []

    async def receive(self, run_dir: str, seconds: float) -> None:
        ours, bare = _configs(run_dir)
        with (
            open_bus(ours, "guiding_controller") as bus,
            open_bus(bare, "recorder"),  # makes the folder
            zenoh.open(session_config(bare, "guiding_controller")) as session,
        ):
            node = Node("guiding_controller", Probe(bus, self._decoded_ns), MonotonicClock())
            reader = asyncio.create_task(self._read(node.stream(HANDLE_STATE, depth=4096)))
            self._loop = asyncio.get_running_loop()
            session.declare_subscriber(_BARE_KEY, self._on_sample)
            sender = await asyncio.create_subprocess_exec(sys.executable, "-m", "benchmarks.hop", run_dir, str(seconds))
            await sender.wait()
            await asyncio.sleep(0.1)
            reader.cancel()
        self._compare(_called(run_dir))

    async def _read(self, messages: AsyncIterator[HandleState]) -> None:
        async for message in messages:
            self._seen.append((message, self._decoded_ns.popleft(), time.monotonic_ns()))

    def _compare(self, called_ns: dict[int, int]) -> None:
        for message, decoded_ns, read_ns in self._seen:
            self.delays_ns["decoded"].append(decoded_ns - called_ns[message.seq])
            self.delays_ns["stream"].append(read_ns - called_ns[message.seq])
            self.delays_ns["turn"].append(read_ns - message.said_ns)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        self.delays_ns["bare"].append(time.monotonic_ns() - int.from_bytes(payload[:8], "little"))
        self._loop.call_soon_threadsafe(self._in_loop, payload)

    def _in_loop(self, payload: bytes) -> None:
        self.delays_ns["loop"].append(time.monotonic_ns() - int.from_bytes(payload[:8], "little"))


class Probe:
    """A bus that looks at the clock when its node has taken a payload in."""

    def __init__(self, bus: ZenohBus, decoded_ns: deque[int]) -> None:
        self._bus = bus
        self._decoded_ns = decoded_ns

    def put(self, key: str, payload: bytes, stance: Stance) -> None:
        self._bus.put(key, payload, stance)

    def subscribe(self, key: str, on_payload: OnPayload) -> None:
        def timed(key: str, payload: bytes) -> None:
            on_payload(key, payload)
            self._decoded_ns.append(time.monotonic_ns())

        self._bus.subscribe(key, timed)

    def mailbox(self, key: str) -> Mailbox:
        return self._bus.mailbox(key)


async def send(run_dir: str, seconds: float) -> None:
    ours, bare = _configs(run_dir)
    with open_bus(ours, "tracker") as bus, zenoh.open(session_config(bare, "tracker")) as session:
        node = Node("tracker", bus, MonotonicClock())
        publish = node.publisher(HANDLE_STATE).publish
        bare_publisher = _bare_publisher(session)
        called_ns: dict[int, int] = {}
        await asyncio.sleep(1.0)  # until the links are up
        async for tick in node.ticks(_RATE_Hz):
            if tick.n >= seconds * _RATE_Hz:
                break
            if tick.n // _TURN_ticks % 2:
                bare_publisher.put(time.monotonic_ns().to_bytes(8, "little") + bytes(_SIZE_bytes - 8))
            else:
                message = _sample(tick.n)
                now_ns = time.monotonic_ns()
                called_ns[publish(message).seq] = now_ns
        _calls_file(run_dir).write_text(json.dumps(list(called_ns.items())))


def _calls_file(run_dir: str) -> Path:
    return Path(run_dir) / "called.json"


def _called(run_dir: str) -> dict[int, int]:
    """When `publish` was called, by the seq that it gave."""
    return dict(json.loads(_calls_file(run_dir).read_text()))


def _bare_publisher(session: zenoh.Session) -> zenoh.Publisher:
    return session.declare_publisher(
        _BARE_KEY,
        priority=zenoh.Priority.REAL_TIME,
        congestion_control=zenoh.CongestionControl.DROP,
    )


def _sample(n: int) -> HandleState:
    return HandleState(
        inputs={"mocap/frame": n},
        position_m=Vec3(x=n / 7, y=n / 11, z=n / 13),
        velocity_mps=Vec3(x=n / 17, y=n / 19, z=n / 23),
        source=HandleSource.MOCAP,
        lag_s=0.02,
    )


def _configs(run_dir: str) -> tuple[BusConfig, BusConfig]:
    return (
        BusConfig(system="ours", run_dir=run_dir, services=SERVICES),
        BusConfig(system="bare", run_dir=run_dir, services=SERVICES),
    )


def _row(
    name: str, delays_ns: Sequence[int], bare_ns: Sequence[int], loop_ns: Sequence[int], sent: int
) -> tuple[str, ...]:
    p50, p99 = (quantile_ms(delays_ns, q) for q in (0.5, 0.99))
    ratios = [p / quantile_ms(than, q) for than in (bare_ns, loop_ns) for p, q in ((p50, 0.5), (p99, 0.99))]
    return (name, f"{p50:.3f}", f"{p99:.3f}", *(f"{ratio:.2f}" for ratio in ratios), str(len(delays_ns)), str(sent))


if __name__ == "__main__":
    if len(sys.argv) == 3:
        asyncio.run(send(sys.argv[1], float(sys.argv[2])))
    else:
        show(run(), COLUMNS)
