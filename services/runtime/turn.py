"""One reading of the clock for all that a loop decides in one turn, so that a recording can show what time it went by."""

import asyncio

from services.runtime.clock import Clock


class Turn:
    """The turn of the event loop that runs now: `number` tells it from others, `now_ns` is the same all through it.

    Whatever is judged by age, and every stamp that a service makes itself, goes by this reading.
    """

    def __init__(self, clock: Clock) -> None:
        self.number = 0
        self._clock = clock
        self._now_ns = 0

    def now_ns(self) -> int:
        """The clock when it was first asked for in this turn."""
        if not self._now_ns:
            self._now_ns = self._clock.now_ns()
            asyncio.get_running_loop().call_soon(self._over)
        return self._now_ns

    def _over(self) -> None:
        self.number += 1
        self._now_ns = 0
