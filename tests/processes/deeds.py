"""What is done to a process."""

import asyncio
import signal
from collections.abc import Callable, Coroutine
from typing import Any

from tests.processes.system import System

Do = Callable[[System, str], Coroutine[Any, Any, None]]
AGAIN_S = 0.5


async def killed(system: System, name: str) -> None:
    """With -9."""
    system.send(name, signal.SIGKILL)


async def restarted(system: System, name: str) -> None:
    """Killed, and started again."""
    await killed(system, name)
    await asyncio.sleep(AGAIN_S)
    await system.start_again(name)


async def leaked(system: System, name: str) -> None:
    """More and more, until something ends it."""
    system.send(name, signal.SIGUSR2)
    await system.until(lambda: system.ended(name) is not None, f"the end of {name}")


def stopped(seconds: float) -> Do:
    """SIGSTOP, and SIGCONT."""
    return lambda system, name: _for_a_while(system, name, signal.SIGSTOP, seconds, signal.SIGCONT)


def spun(seconds: float) -> Do:
    """In a busy loop with the interpreter's lock."""
    return lambda system, name: _for_a_while(system, name, signal.SIGUSR1, seconds, signal.SIGUSR1)


async def _for_a_while(system: System, name: str, begin: int, seconds: float, end: int) -> None:
    system.send(name, begin)
    await asyncio.sleep(seconds)
    system.send(name, end)
