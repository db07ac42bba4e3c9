"""What followed a fault, as the bus told it: times in s since the fault, by the stamps of this host's clock."""

import time
from bisect import bisect_left, bisect_right
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from schemas.safety import Level, Phase
from schemas.topics import SAFETY_STATE, SETPOINT, TRUTH, VEHICLE_STATE
from schemas.vehicle import FlightMode, SetpointKind
from services.faults.record import pull_N
from services.physics import norm

T = TypeVar("T")

SLACK = (SetpointKind.EASE, SetpointKind.HOLD)
LANDS = (FlightMode.LAND, FlightMode.DESCEND)
CALM_S = 0.5
SUNK_M = 0.15
NEVER = float("inf")


@dataclass(repr=False)
class Window:
    """From one fault to the end of its test."""

    heard: dict[str, list[Any]]
    begin_s: float
    end_s: float = NEVER
    waits: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    """What the host has taken from all who could have reacted, in sum, by the clock."""
    done_s: float = 0.0
    """When it was over, or had done its work."""

    def all(self, topic: Any, begin_s: float = 0.0, end_s: float = NEVER) -> list[tuple[float, Any]]:
        """Messages with their time, from `begin_s` to `end_s` and no longer than the window."""
        heard, until_s = self.heard[topic.key], min(end_s, self.end_s - self.begin_s)
        first = bisect_right(heard, begin_s, key=self._t_s)
        return [(self._t_s(m), m) for m in heard[first : bisect_left(heard, until_s, key=self._t_s)]]

    def _t_s(self, message: Any) -> float:
        return float(message.stamp_ns * 1e-9 - self.begin_s)

    def waited_s(self, end_s: float) -> float:
        """What the host took until `end_s`."""
        known = [waited for t, waited in self.waits if t - self.begin_s < end_s]
        return known[-1] - known[0] if known else 0.0

    @property
    def age_s(self) -> float:
        """Now."""
        return time.monotonic() - self.begin_s

    def lands_s(self) -> float:
        """Until the bridge is told that the autopilot lands."""
        return next((t for t, m in self.all(VEHICLE_STATE) if m.mode in LANDS), NEVER)

    def comes_down_s(self) -> float:
        """Until somebody brings it down: the autopilot, or the supervisor, who clears the place first."""
        told = (t for t, m in self.all(SAFETY_STATE) if m.phase in (Phase.CLEARING, Phase.LANDING))
        return min(next(told, NEVER), self.lands_s())

    def backs_off_s(self) -> float:
        """Until the first set-point without a pull, or the autopilot lands."""
        slack = (t for t, m in self.all(SETPOINT) if m.kind in SLACK)
        return min(next(slack, NEVER), self.lands_s())

    def silent_s(self) -> float:
        """Until the last set-point."""
        return max((t for t, _ in self.all(SETPOINT)), default=0.0)

    def sinks_s(self) -> float:
        """Until the vehicle is a hand's breadth lower than it has been."""
        highest_m = 0.0
        for t, m in self.all(TRUTH):
            highest_m = max(highest_m, m.robot_position_m.z)
            if m.robot_position_m.z < highest_m - SUNK_M:
                return t
        return NEVER

    def pull_N(self, begin_s: float, end_s: float = NEVER) -> float:
        """The strongest of the cable on the hand."""
        return max((pull_N(m) for _, m in self.all(TRUTH, begin_s, end_s)), default=0.0)

    def pull_after_N(self) -> float:
        """The strongest from half a second after backing off, for as long as it stays backed off.

        A hand that holds on when the autopilot takes the vehicle down carries some of it, whatever is commanded.
        """
        begin_s = self.backs_off_s()
        again = (t for t, m in self.all(SETPOINT, begin_s) if m.kind not in SLACK)
        end_s = min(next(again, NEVER), self.lands_s())
        return self.pull_N(begin_s + CALM_S + self.waited_s(begin_s + CALM_S), end_s)

    def commanded_N(self, begin_s: float = 0.0, end_s: float = NEVER) -> float:
        """The largest u_A."""
        sent = (m for _, m in self.all(SETPOINT, begin_s, end_s) if m.kind is not SetpointKind.POSITION)
        return max((float(norm(m.u_A_N.array())) for m in sent), default=0.0)

    def levels(self) -> set[Level]:
        """That the supervisor said."""
        return {m.level for _, m in self.all(SAFETY_STATE)}

    def phases(self) -> list[Phase]:
        """In order, each once."""
        return list(dict.fromkeys(m.phase for _, m in self.all(SAFETY_STATE)))

    def reasons(self) -> list[str]:
        """What the operator was told first, each once."""
        return list(dict.fromkeys(m.reasons[0] for _, m in self.all(SAFETY_STATE) if m.reasons))

    def __repr__(self) -> str:
        """For a verdict that is no."""
        lines = (
            f"backs off after {self.backs_off_s():.3f} s, until when the host took {self.waited_s(self.backs_off_s()):.3f} s",
            f"silent after {self.silent_s():.3f} s, sinks after {self.sinks_s():.2f} s",
            f"pull {self.pull_N(-0.5, 0.0):.2f} N before, {self.pull_after_N():.2f} N after backing off",
            f"commanded {self.commanded_N():.2f} N, {self.commanded_N(-0.5, 0.0):.2f} N before",
            *(f"{phase}" for phase in self.phases()),
            *self.reasons(),
        )
        return "; ".join(lines)


@dataclass
class Flown(Generic[T]):
    """What followed each ill of a flight, or was found out in it, as far as it went, and why it went no further."""

    windows: dict[Any, T] = field(default_factory=dict[Any, T])
    over: str = ""

    def __getitem__(self, ill: Any) -> T:
        """Raises AssertionError with why the flight was over before."""
        assert ill in self.windows, f"the flight was over: {self.over}"
        return self.windows[ill]

    @contextmanager
    def tried(self) -> Generator[None]:
        """What ends the flight early is the verdict of every ill that was to follow, and not flown again for each."""
        try:
            yield
        except Exception as why:
            self.over = f"{type(why).__name__}: {why}"
