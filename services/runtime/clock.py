"""Where stamps come from: the monotonic clock of the host, or virtual time (virtual.py)."""

import time
from typing import Protocol


class Clock(Protocol):
    """Never runs backwards."""

    def now_ns(self) -> int:
        """Nanoseconds since an origin that all services of one host share."""
        ...


class MonotonicClock:
    """CLOCK_MONOTONIC: one origin for all processes of the host, untouched by the time of day."""

    def now_ns(self) -> int:
        """Nanoseconds since about the start of the host."""
        return time.monotonic_ns()
