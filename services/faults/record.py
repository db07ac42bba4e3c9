"""One flight as arrays, from its fault on."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from schemas.simulation import Truth
from schemas.topics import SAFETY_STATE, SETPOINT, TRUTH
from schemas.vehicle import FlightMode, SetpointKind
from services.physics import Array, norm
from services.rehearsal.chain import Flight

NEVER = float("inf")


def pull_N(truth: Truth) -> float:
    """Of the cable on the hand that holds: what is more than the carrying of the handle, which a slack cable leaves to it."""
    if not truth.holding:
        return 0.0
    return float(min(norm(truth.cable_force_N.array()), norm(truth.hand_force_N.array())))


class Record:
    """One flight as arrays, from the fault on, times counted from it."""

    def __init__(self, flight: Flight, begin_s: float) -> None:
        self.flight, self.begin_s = flight, begin_s
        self.sent = flight.said[SETPOINT.key]
        self.states = flight.said[SAFETY_STATE.key]
        self.truth = flight.said[TRUTH.key]
        self.sent_s, self.state_s, self.truth_s = (self._times(m) for m in (self.sent, self.states, self.truth))
        self.pull_N = np.array([pull_N(m) for m in self.truth])
        self.u_A_N = np.array(
            [norm(m.u_A_N.array()) if m.kind is not SetpointKind.POSITION else 0.0 for m in self.sent]
        )
        self.modes = [(ns * 1e-9 - begin_s, mode, armed) for ns, mode, armed in flight.vehicle.modes]

    def _times(self, messages: Sequence[Any]) -> Array:
        return np.array([m.stamp_ns for m in messages]) * 1e-9 - self.begin_s

    def first(self, times: Array, messages: Sequence[Any], shows: Callable[[Any], bool]) -> float:
        """When a message after the fault first shows it."""
        return next((float(t) for t, m in zip(times, messages, strict=True) if t > 0.0 and shows(m)), NEVER)

    def now(self) -> list[tuple[float, FlightMode, bool]]:
        """The autopilot's modes from the one that the fault found on."""
        found = max((n for n, (t, _, _) in enumerate(self.modes) if t <= 0.0), default=0)
        return self.modes[found:]

    def tips_m(self, of: str) -> Array:
        """Nearest rotor tip to the person's hand or head, while the motors run and since the fault."""
        tip_m = self.flight.config.safety_supervisor.envelope.rotor_tip_m
        off_s = next((t for t, _, armed in self.modes if t > 0.0 and not armed), NEVER)
        return np.array(
            [
                norm(m.robot_position_m.array() - getattr(m, f"{of}_position_m").array()) - tip_m
                for t, m in zip(self.truth_s, self.truth, strict=True)
                if 0.0 < t < off_s
            ]
            or [NEVER]
        )
