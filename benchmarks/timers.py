"""A loop at 1 kHz: Node.ticks beside a bare timerfd in the same asyncio loop, and beside asyncio's own call_at.

Each runs alone, in turns of one second, so that all meet the same load. Lateness of a turn is counted from the first
period that it serves. Both publish nothing; `missed` counts periods that were served by a later turn.
`python -m benchmarks.timers`
"""

import asyncio
import os
import time
from collections.abc import Awaitable, Callable, Sequence

from benchmarks.table import quantile_ms, show
from services.runtime import timerfd
from services.runtime.clock import MonotonicClock
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node

COLUMNS = ("1 kHz loop", "late p50 ms", "late p99 ms", "p50 to bare", "p99 to bare", "turns", "missed")

_PERIOD_ns = 1_000_000

Lateness = list[tuple[int, int]]
"""(late in ns, missed periods) of each turn."""


def run(rounds: int = 5, seconds: float = 1.0) -> list[tuple[str, ...]]:
    """Rows under COLUMNS; the first is the bare timerfd."""
    turns: dict[str, Lateness] = {name: [] for name in _LOOPS}
    for _ in range(rounds):
        for name, loop in _LOOPS.items():
            turns[name] += asyncio.run(_timed(loop, round(seconds * 1e9)))
    bare = [late for late, _ in turns["bare timerfd"]]
    return [_row(name, served, bare) for name, served in turns.items()]


async def _timed(loop: Callable[[int], Awaitable[Lateness]], duration_ns: int) -> Lateness:
    return await loop(duration_ns)


async def _bare(duration_ns: int) -> Lateness:
    served: Lateness = []
    loop, fd, end = asyncio.get_running_loop(), timerfd.create(), asyncio.Event()
    due_ns = begin_ns = time.monotonic_ns() + _PERIOD_ns

    def expire() -> None:
        nonlocal due_ns
        count = int.from_bytes(os.read(fd, 8), "little")
        served.append((time.monotonic_ns() - due_ns, count - 1))
        due_ns += count * _PERIOD_ns
        if due_ns - begin_ns > duration_ns:
            end.set()

    timerfd.start(fd, due_ns, _PERIOD_ns)
    loop.add_reader(fd, expire)
    await end.wait()
    loop.remove_reader(fd)
    os.close(fd)
    return served


async def _ticks(duration_ns: int) -> Lateness:
    served: Lateness = []
    node = Node("tracker", MemoryBus(), MonotonicClock())
    end_ns = time.monotonic_ns() + duration_ns
    async for tick in node.ticks(1e9 / _PERIOD_ns):
        served.append((time.monotonic_ns() - tick.stamp_ns + tick.missed * _PERIOD_ns, tick.missed))
        if tick.stamp_ns > end_ns:
            break
    return served


async def _call_at(duration_ns: int) -> Lateness:
    served: Lateness = []
    loop = asyncio.get_running_loop()
    due_ns = time.monotonic_ns() + _PERIOD_ns
    end_ns = due_ns + duration_ns
    while due_ns < end_ns:
        turn = asyncio.Event()
        loop.call_at(due_ns * 1e-9, turn.set)
        await turn.wait()
        late_ns = time.monotonic_ns() - due_ns
        missed = max(late_ns, 0) // _PERIOD_ns
        served.append((late_ns, missed))
        due_ns += (1 + missed) * _PERIOD_ns
    return served


_LOOPS: dict[str, Callable[[int], Awaitable[Lateness]]] = {
    "bare timerfd": _bare,
    "Node.ticks": _ticks,
    "loop.call_at": _call_at,
}


def _row(name: str, served: Lateness, bare_ns: Sequence[int]) -> tuple[str, ...]:
    late = [late_ns for late_ns, _ in served]
    p50, p99 = (quantile_ms(late, q) for q in (0.5, 0.99))
    ratios = p50 / quantile_ms(bare_ns, 0.5), p99 / quantile_ms(bare_ns, 0.99)
    missed = sum(missed for _, missed in served)
    return (name, f"{p50:.3f}", f"{p99:.3f}", *(f"{ratio:.2f}" for ratio in ratios), str(len(served)), str(missed))


if __name__ == "__main__":
    show(run(), COLUMNS)
