"""What the host does to a flight: a place before all else for its loops, as deployed, and how much it took away all the same."""

import os
import subprocess
from collections.abc import Generator, Iterable
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

TICKS_PER_S = os.sysconf("SC_CLK_TCK")
LOOPS, STARTS, TEST = 20, 15, 10
"""SCHED_FIFO: the loops go before a service that starts, that before the test that breaks them, that before all else."""


class Waits:
    """For how long threads of these processes have stood in line for a processor since this was made, and what a hypervisor
    took from all; a thread that ends takes nothing back."""

    def __init__(self, pids: Iterable[int]) -> None:
        self._pids, self._known_s = list(pids), dict[Path, float]()
        self._sum_s = 0.0
        self._began_s = _stolen_s()
        self.in_all_s()
        self._sum_s = 0.0

    def in_all_s(self) -> float:
        """Until now."""
        for pid in self._pids:
            for thread in Path(f"/proc/{pid}/task").glob("*/schedstat"):
                with suppress(OSError):  # the thread, or the process, has ended meanwhile
                    waited_s = int(thread.read_text().split()[1]) * 1e-9
                    self._sum_s += waited_s - self._known_s.get(thread, 0.0)
                    self._known_s[thread] = waited_s
        return self._sum_s + _stolen_s() - self._began_s


def _stolen_s() -> float:
    words = Path("/proc/stat").read_text().split("\n", 1)[0].split()
    return int(words[8]) / TICKS_PER_S


@cache
def may_go_first() -> bool:
    """Whether this user may have real-time priorities, as a host has them where Clew is installed."""
    return subprocess.run(["chrt", "-f", "1", "true"], capture_output=True, check=False).returncode == 0


def first(*, loop: bool) -> list[str]:
    """What the command of a service begins with."""
    if not may_go_first():
        return []
    return ["chrt", "-f", str(STARTS), *(["env", f"CLEW_FIFO={LOOPS}"] if loop else [])]


def go_with_the_others(pid: int) -> None:
    """Take all threads of a process their priority."""
    _schedule(pid, os.SCHED_OTHER, 0)


def go_first(pid: int) -> None:
    """Give all threads of a process the loops' priority, where that is permitted."""
    _schedule(pid, os.SCHED_FIFO, LOOPS)


def _schedule(pid: int, policy: int, priority: int) -> None:
    for task in os.listdir(f"/proc/{pid}/task"):
        with suppress(PermissionError):
            os.sched_setscheduler(int(task), policy, os.sched_param(priority))


@contextmanager
def real_time(priority: int) -> Generator[None]:
    """For this thread and all that it starts, Zenoh's threads above all: they hold the interpreter's lock in their callbacks.

    Without a word where that is not permitted.
    """
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    try:
        yield
    finally:
        with suppress(PermissionError):
            os.sched_setscheduler(0, policy, parameters)
