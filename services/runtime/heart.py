"""Health is written by the service's own loop: a loop that hangs falls silent."""

import asyncio
import os
import time
from collections.abc import Callable, Mapping

from schemas.health import Heartbeat
from services.runtime import watchdog
from services.runtime.ticker import LoopStats
from services.runtime.turn import Turn
from services.runtime.virtual import VirtualLoop

PERIOD_s = 0.5


class Heart:
    """Beats twice a second from within the turns of the loop, and from streams that wait for their next message."""

    def __init__(self, turn: Turn, publish: Callable[[], None] | None) -> None:
        self.stats = LoopStats()
        self.sleepers: list[Callable[[], None]] = []
        self._turn = turn
        self._publish = publish
        self._due_ns = 0
        self._armed = False

    def turn(self) -> None:
        """One turn of a loop that is driven by messages."""
        self.stats.turns += 1
        self.beat()

    def beat(self) -> None:
        """Publish if it is time."""
        if self._publish is None:
            return
        now_ns = self._turn.now_ns()
        if now_ns >= self._due_ns:
            self._due_ns = now_ns + round(PERIOD_s * 1e9)
            self._publish()
            watchdog.feed()

    def wake_later(self) -> None:
        """Wake the waiting streams for the next beat; without a publisher nobody has to wake."""
        if self._publish and not self._armed:
            self._armed = True
            asyncio.get_running_loop().call_later(PERIOD_s, self._wake)

    def _wake(self) -> None:
        self._armed = False
        for wake in self.sleepers:
            wake()


class Report:
    """Composes heartbeats. On virtual time the host's figures are 0, so that two equal runs say the same."""

    def __init__(self, name: str, turn: Turn) -> None:
        self._name = name
        self._turn = turn
        self._last = (0, 0, 0)

    def heartbeat(
        self, stats: LoopStats, received: Mapping[str, int], rejected: Mapping[str, int], status: str
    ) -> Heartbeat:
        """The word of the service about itself, since the last one where it is a rate."""
        virtual = isinstance(asyncio.get_running_loop(), VirtualLoop)
        now = (self._turn.now_ns(), stats.turns, 0 if virtual else time.process_time_ns())
        wall_ns, turns, cpu_ns = (new - old for new, old in zip(now, self._last, strict=True))
        first = not self._last[0]
        self._last = now
        return Heartbeat(
            service=self._name,
            pid=0 if virtual else os.getpid(),
            loop_rate_Hz=0.0 if first else turns * 1e9 / wall_ns,
            loop_lateness_p99_ms=stats.lateness_ms(0.99),
            missed_periods=stats.missed,
            longest_stall_ms=stats.longest_stall_ns * 1e-6,
            cpu_fraction=0.0 if first else cpu_ns / wall_ns,
            received=dict(received),
            rejected=dict(rejected),
            status=status,
        )
