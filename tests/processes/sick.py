"""A service as `clew run` runs it, that falls ill when told: `python -m tests.processes.sick run --profile FILE NAME`.

SIGUSR1 makes it spin and never let go of the interpreter's lock, until the next SIGUSR1; SIGUSR2 makes it leak. It spins
with what the others leave of the processors: what becomes of them where none is left is another fault (test_commands.py).
"""

import asyncio
import os
import signal
import sys

from services.console import cli

LEAK_BYTES, LEAK_PERIOD_S = 16 << 20, 0.01

_spins = False
_kept: list[bytes] = []


def spin(*_: object) -> None:
    """In the loop's thread, so that the loop hangs; the second signal comes in while the first still spins."""
    global _spins
    _spins = not _spins
    before_s, place, priority = sys.getswitchinterval(), os.sched_getscheduler(0), os.sched_getparam(0)
    sys.setswitchinterval(1e6)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    while _spins:
        pass
    os.sched_setscheduler(0, place, priority)
    sys.setswitchinterval(min(before_s, 1.0))


def leak(*_: object) -> None:
    """More and more, until something stops it."""
    _kept.append(os.urandom(1) * LEAK_BYTES)
    asyncio.get_running_loop().call_later(LEAK_PERIOD_S, leak)


if __name__ == "__main__":
    signal.signal(signal.SIGUSR1, spin)
    signal.signal(signal.SIGUSR2, leak)
    cli.main()
