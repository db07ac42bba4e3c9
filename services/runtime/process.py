"""The life of one service process: from its name to its exit code, and no way to hang in between."""

import asyncio
import ctypes
import gc
import os
import resource
import signal
import sys
import traceback
from collections.abc import Callable, Coroutine
from types import FrameType
from typing import Any, TypeVar, cast

from services.runtime.bus_config import BusConfig
from services.runtime.clock import MonotonicClock
from services.runtime.node import Node
from services.runtime.plain import PlainError
from services.runtime.zenoh_bus import open_bus

Config = TypeVar("Config")

GRACE_s = 1.5
"""From the first request to stop, or the first error, to the kernel's end of the process."""

MEMORY_MAX_bytes = 1 << 30
"""Of a process's own data, three times what a service needs: who leaks fails by itself, before the host has none left."""

_PR_SET_PDEATHSIG = 1


def serve(
    name: str, run: Callable[[Node, Config], Coroutine[Any, Any, None]], config: Config, bus_config: BusConfig
) -> int:
    """Run one service until it finishes, fails or is asked to stop; returns the exit code: the caller must end with it.

    SIGINT or SIGTERM asks: `run` is cancelled and has 1.5 s to end. A second one ends the process at once.
    Environment: CLEW_DIE_WITH_PARENT=<pid of the parent> ends the service with it; CLEW_FIFO=<1..99> asks the kernel
    for real-time scheduling and goes on without it where that is not permitted.
    """
    _die_with_parent(os.environ.get("CLEW_DIE_WITH_PARENT"))
    _limit_memory()
    scheduler = _real_time(os.environ.get("CLEW_FIFO"))
    life = _Life(name)
    try:
        with open_bus(bus_config, name) as bus, asyncio.Runner() as runner:
            node = Node(name, bus, MonotonicClock(), placement=bus_config.placement)
            node.host_status = scheduler
            return runner.run(life.of(run(node, config)))
    except (RuntimeError, ValueError, OSError) as why:  # the session could not be opened: one line says all
        return life.failed(why)


class _Life:
    """From the first signal or the first error there is no way back, and a bound on the time to the end."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._asked = False
        self._cancel: Callable[[], object] | None = None
        self._stray: BaseException | None = None
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._ask)  # not the loop's: these also work while the loop hangs in Python code

    async def of(self, service: Coroutine[Any, Any, None]) -> int:
        """Await the service; returns the exit code."""
        loop = asyncio.get_running_loop()
        task = asyncio.ensure_future(service)
        self._cancel = lambda: loop.call_soon_threadsafe(task.cancel)
        loop.set_exception_handler(self._on_stray)
        _tune_garbage_collection()
        if self._asked:
            task.cancel()
        try:
            await task
        except (Exception, asyncio.CancelledError) as why:
            stopped = self._asked and isinstance(why, asyncio.CancelledError)
            return 0 if stopped else self._ended_by(self._stray or why)
        finally:
            _kill_after(GRACE_s)  # closing must not hang either
            self._cancel = None  # the loop is about to close
        return 0

    def _ended_by(self, why: BaseException) -> int:
        alone = _alone(why)
        return self.failed(alone, trace=not isinstance(alone, PlainError))

    def failed(self, why: BaseException, *, trace: bool = False) -> int:
        """Say why, in one line first; returns the exit code."""
        lines = traceback.format_exception(why) if trace else ()
        text = f"{self._name} failed: {type(why).__name__}: {why}\n"
        print(text, *lines, sep="", end="", file=sys.stderr, flush=True)  # noqa: T201
        return 1

    def _ask(self, number: int, _frame: FrameType | None) -> None:
        if self._asked:
            os._exit(128 + number)
        self._asked = True
        _kill_after(GRACE_s)
        if self._cancel:
            self._cancel()

    def _on_stray(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """An error in a callback or in a task that nobody awaits is an error of the service."""
        loop.default_exception_handler(context)
        self._stray = self._stray or context.get("exception")
        if self._stray and self._cancel:
            self._cancel()


def _alone(why: BaseException) -> BaseException:
    """Of a task group in which one loop failed, that loop's error."""
    if not isinstance(why, BaseExceptionGroup):
        return why
    failed = cast("BaseExceptionGroup[BaseException]", why).exceptions
    return _alone(failed[0]) if len(failed) == 1 else cast(BaseException, why)


def _kill_after(seconds: float) -> None:
    """Let the kernel end this process, whatever its threads are stuck in."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, seconds)


def _die_with_parent(parent: str | None) -> None:
    """Ask the kernel for SIGTERM when the parent dies, even by kill -9; Linux."""
    if not parent:
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if int(parent) not in (1, os.getppid()):  # it died before the kernel knew
        sys.exit(1)


def _limit_memory() -> None:
    """An allocation beyond it fails; Linux counts private memory that may be written, used or not, in the whole process."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = MEMORY_MAX_bytes if hard == resource.RLIM_INFINITY else min(MEMORY_MAX_bytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (most, hard))


def _real_time(priority: str | None) -> str:
    """Says in the health what came of it. Threads that start later inherit it."""
    if not priority:
        return ""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(int(priority)))
    except PermissionError:
        return "(no real-time scheduling: not permitted)"
    return f"(SCHED_FIFO {priority})"


def _tune_garbage_collection() -> None:
    """Modules and models live for ever: keep the collector from walking over them in every full collection."""
    gc.collect()
    gc.freeze()
