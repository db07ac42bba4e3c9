"""A service's loop: ticks at a fixed rate, on the kernel's timer or on virtual time, and how late they were."""

import asyncio
import os
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass

from services.runtime import timerfd
from services.runtime.virtual import VirtualLoop

STALL_ns = 100_000_000
"""Later than this, the host took the processor away (or the loop's own body took far too long)."""

_RING = 1024


@dataclass(frozen=True, slots=True)
class Tick:
    """One turn of the loop. A turn that comes late stands for the missed periods too."""

    n: int
    """Counts the turns from 0."""
    dt_s: float
    """(1 + missed) / rate, exactly: the time this turn stands for."""
    missed: int
    stamp_ns: int
    """When the newest period was due."""


class LoopStats:
    """How punctual a loop is. `late_ns` of a turn is counted from the first period that it serves."""

    def __init__(self) -> None:
        self.turns = 0
        self.missed = 0
        self.stalls = 0
        self.longest_stall_ns = 0
        self._late_ns: deque[int] = deque(maxlen=_RING)

    def note(self, late_ns: int, missed: int) -> None:
        """Count one turn."""
        self.turns += 1
        self.missed += missed
        self.stalls += late_ns > STALL_ns
        self.longest_stall_ns = max(self.longest_stall_ns, late_ns)
        self._late_ns.append(late_ns)

    def lateness_ms(self, quantile: float) -> float:
        """Of the last 1024 turns; 0 before the first."""
        late = sorted(self._late_ns)
        return late[min(int(quantile * len(late)), len(late) - 1)] * 1e-6 if late else 0.0


async def ticks(rate_Hz: float, stats: LoopStats, beat: Callable[[], None]) -> AsyncIterator[Tick]:
    """Tick at `rate_Hz`, first one period from now, without drift whatever the body takes; `beat` on each turn."""
    period_ns = round(1e9 / rate_Hz)
    loop = asyncio.get_running_loop()
    virtual = loop if isinstance(loop, VirtualLoop) else None
    now_ns: Callable[[], int] = (lambda: virtual.now_ns) if virtual else time.monotonic_ns
    due_ns = now_ns() + period_ns
    periods = _Periods()
    n = 0
    with _virtual(virtual, due_ns, period_ns, periods) if virtual else _kernel(loop, due_ns, period_ns, periods):
        while True:
            count = await periods.take()
            stats.note(now_ns() - due_ns, count - 1)
            due_ns += count * period_ns
            beat()
            yield Tick(n, count / rate_Hz, count - 1, due_ns - period_ns)
            n += 1


class _Periods:
    """Those that are over and not yet served."""

    def __init__(self) -> None:
        self._over = 0
        self._waiter: asyncio.Future[None] | None = None

    def add(self, count: int) -> None:
        self._over += count
        if count and self._waiter and not self._waiter.done():
            self._waiter.set_result(None)

    async def take(self) -> int:
        """At least 1; waits for it."""
        if not self._over:
            self._waiter = asyncio.get_running_loop().create_future()
            await self._waiter
        count, self._over = self._over, 0
        return count


@contextmanager
def _kernel(loop: asyncio.AbstractEventLoop, first_ns: int, period_ns: int, periods: _Periods) -> Generator[None]:
    fd = timerfd.create()
    try:
        timerfd.start(fd, first_ns, period_ns)
        loop.add_reader(fd, lambda: periods.add(timerfd.expirations(fd)))
        yield
    finally:
        loop.remove_reader(fd)
        os.close(fd)


@contextmanager
def _virtual(loop: VirtualLoop, first_ns: int, period_ns: int, periods: _Periods) -> Generator[None]:
    def expire() -> None:
        nonlocal due_ns, handle
        due_ns += period_ns
        handle = loop.call_at(due_ns * 1e-9, expire)
        periods.add(1)

    due_ns = first_ns
    handle = loop.call_at(due_ns * 1e-9, expire)
    try:
        yield
    finally:
        handle.cancel()
