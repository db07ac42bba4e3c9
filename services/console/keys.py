"""Keys of the live panel: single presses, read only where standard input is a terminal, which is put back as it was."""

import asyncio
import os
import sys
import termios
import tty
from collections.abc import Callable, Generator
from contextlib import contextmanager

from schemas.safety import Action

KEYS = {" ": Action.EASE, "s": Action.EASE, "h": Action.HOLD, "l": Action.LAND, "K": Action.KILL, "r": Action.RESUME}
HINT = "space stop · h hold · l land · shift-K motors off · r resume"


@contextmanager
def listening(act: Callable[[Action], None]) -> Generator[bool]:
    """Call `act` in the running loop for each key that means something; says whether there is a terminal to read."""
    if not sys.stdin.isatty():
        yield False
        return
    fd, loop = sys.stdin.fileno(), asyncio.get_running_loop()
    before = termios.tcgetattr(fd)
    tty.setcbreak(fd)  # Ctrl-C still works
    loop.add_reader(fd, lambda: _read(fd, act))
    try:
        yield True
    finally:
        loop.remove_reader(fd)
        termios.tcsetattr(fd, termios.TCSADRAIN, before)


def _read(fd: int, act: Callable[[Action], None]) -> None:
    for key in os.read(fd, 64).decode(errors="ignore"):
        if key in KEYS:
            act(KEYS[key])
