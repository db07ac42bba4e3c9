"""The kernel's periodic timer, which counts the periods that its reader missed. Linux."""

import ctypes
import os
import sys
import time
from typing import Any

_TFD_TIMER_ABSTIME = 1


def create() -> int:
    """A non-blocking, close-on-exec timer on CLOCK_MONOTONIC, as a file descriptor."""
    if sys.version_info >= (3, 13):
        return os.timerfd_create(time.CLOCK_MONOTONIC, flags=os.TFD_NONBLOCK | os.TFD_CLOEXEC)
    return _checked(_libc().timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC))


def start(fd: int, first_ns: int, period_ns: int) -> None:
    """Expire at `first_ns` of time.monotonic_ns(), then every `period_ns`."""
    if sys.version_info >= (3, 13):
        os.timerfd_settime_ns(fd, flags=os.TFD_TIMER_ABSTIME, initial=first_ns, interval=period_ns)
        return
    spec = (ctypes.c_long * 4)(*divmod(period_ns, 10**9), *divmod(first_ns, 10**9))  # struct itimerspec
    _checked(_libc().timerfd_settime(fd, _TFD_TIMER_ABSTIME, spec, None))


def expirations(fd: int) -> int:
    """How often it has expired since the last call."""
    try:
        return int.from_bytes(os.read(fd, 8), "little")
    except BlockingIOError:
        return 0


def _libc() -> Any:
    return ctypes.CDLL(None, use_errno=True)


def _checked(result: int) -> int:
    if result < 0:
        errno = ctypes.get_errno()
        raise OSError(errno, f"timerfd: {os.strerror(errno)}")
    return result
