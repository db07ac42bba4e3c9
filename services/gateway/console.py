"""The clock of a person's console that is neither host: the ground's, asked for over the radio."""

import json
import time

from services.gateway import offset
from services.gateway.service import GROUND_CLOCK
from services.runtime.clock import Clock, MonotonicClock
from services.runtime.zenoh_bus import ZenohBus

QUESTIONS = 5


class OffsetClock:
    """The monotonic clock of this host, moved."""

    def __init__(self, lead_ns: int) -> None:
        self._lead_ns = lead_ns

    def now_ns(self) -> int:
        """On the other host's clock."""
        return time.monotonic_ns() + self._lead_ns


def ground_clock(bus: ZenohBus) -> Clock:
    """From the best of a few questions; without an answer this host's own clock, by which nothing will be fresh."""
    answers: tuple[offset.Answer, ...] = ()
    for _ in range(QUESTIONS):
        t_0_ns = time.monotonic_ns()
        if reply := bus.ask_now(GROUND_CLOCK, 1.0):
            answers = offset.step(answers, offset.Answer(t_0_ns, json.loads(reply[0])[0], reply[1]))
    known = offset.estimate(answers, time.monotonic_ns(), 0.0)
    return OffsetClock(known.theta_ns) if known else MonotonicClock()
