"""Virtual time: an asyncio loop that jumps to the next timer instead of sleeping. A flight takes seconds and repeats.

Time stands still while code runs. Timers fire one at a time, by their time and then in the order of their making; all
that one timer sets off is finished before the next. Only timers and callbacks exist here: no sockets, no threads.
"""

import asyncio
import heapq
import selectors
from collections import deque
from collections.abc import Callable, Coroutine
from contextvars import Context
from typing import Any, TypeVar

T = TypeVar("T")

START_ns = 1_000_000_000
"""Virtual time begins at 1 s, because a stamp of 0 means: not stamped yet."""

LIMIT_s = 3600.0


class Deadlock(RuntimeError):
    """Every task waits and no timer is set: nothing can ever happen again."""


class VirtualLoop(asyncio.SelectorEventLoop):
    """A loop whose clock moves only when nothing is left to do."""

    def __init__(self, limit_s: float = LIMIT_s) -> None:
        self.now_ns = START_ns
        self._limit_ns = START_ns + round(limit_s * 1e9)
        self._timers: list[tuple[int, int, asyncio.TimerHandle]] = []
        self._made = 0
        self._ready: deque[asyncio.Handle]
        super().__init__(_Selector(self.advance))

    def time(self) -> float:
        """Virtual seconds."""
        return self.now_ns * 1e-9

    def call_at(
        self, when: float, callback: Callable[..., object], *args: Any, context: Context | None = None
    ) -> asyncio.TimerHandle:
        """As asyncio's, but timers of equal time keep their order, which asyncio's heap does not promise."""
        handle = asyncio.TimerHandle(when, callback, args, self, context)
        self._made += 1
        heapq.heappush(self._timers, (max(round(when * 1e9), self.now_ns), self._made, handle))
        return handle

    def advance(self) -> None:
        """Jump to the next timer and let it fire.

        Raises:
            Deadlock: no timer is set.
            TimeoutError: the run has used up its virtual time.
        """
        while self._timers:
            when_ns, _, handle = heapq.heappop(self._timers)
            if not handle.cancelled():
                break
        else:
            raise Deadlock(f"nothing is scheduled at {self.time():.3f} s; waiting: {_waiting(self)}")
        if when_ns > self._limit_ns:
            raise TimeoutError(f"not finished at {self.time():.3f} s of virtual time")
        self.now_ns = when_ns
        self._ready.append(handle)  # as asyncio does with a timer that is due


class VirtualClock:
    """The time of the virtual loop that runs."""

    def now_ns(self) -> int:
        """Virtual nanoseconds; exact."""
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop), "a VirtualClock needs run_virtual"
        return loop.now_ns


def run_virtual(coro: Coroutine[Any, Any, T], *, limit_s: float = LIMIT_s) -> T:
    """Run `coro` to its end on virtual time, as asyncio.run does on real time.

    Raises:
        Deadlock: nothing is scheduled and `coro` has not finished.
        TimeoutError: `coro` has not finished after `limit_s` virtual seconds.
    """
    with asyncio.Runner(loop_factory=lambda: VirtualLoop(limit_s)) as runner:
        return runner.run(coro)


class _Selector(selectors.DefaultSelector):
    """Where asyncio would sleep, time advances."""

    def __init__(self, advance: Callable[[], None]) -> None:
        super().__init__()
        self._advance = advance

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if timeout == 0:  # something is ready, and nobody outside can be quicker than this loop
            return []
        ready = super().select(0)
        if not ready:  # the loop knows of no timers, so it would wait for ever
            self._advance()
        return ready


def _waiting(loop: asyncio.AbstractEventLoop) -> str:
    return ", ".join(sorted(task.get_name() for task in asyncio.all_tasks(loop))) or "nobody"
