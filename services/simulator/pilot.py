"""Who flies the simulated vehicle: the stand-in autopilot here, or PX4 (px4_hil.py). The seam between world and autopilot."""

from typing import Protocol

import numpy as np

from services.physics import Array
from services.simulator import autopilot
from services.simulator.autopilot import STEP_S, Autopilot, Link, Sensors
from services.simulator.quadrotor import QuadrotorState


class Pilot(Protocol):
    """One sample of its sensors every 4 ms of its time, and what it makes the motors do until the next."""

    def motors(self) -> Array:
        """The answer to the newest sample, (4,) in 0..1; zero before the first."""
        ...

    def sense(self, sensors: Sensors) -> None:
        """A new sample."""
        ...

    def miss(self, seconds: float) -> None:
        """The host took the processor away and the world stood still; the pilot's clock did not."""
        ...


class StandIn(Pilot):
    """The stand-in autopilot and its link to the companion."""

    def __init__(self, p: Autopilot, robot: QuadrotorState, link: Link) -> None:
        self._p, self._link = p, link
        self._state = autopilot.initial(robot.p_W, robot.q_WB_wxyz, p)
        self._motors = np.zeros(4)

    def motors(self) -> Array:
        """As it was decided on the newest sample."""
        return self._motors

    def sense(self, sensors: Sensors) -> None:
        """Fly one step, with what has come over the link."""
        self._state, output = autopilot.step(self._state, sensors, self._link.receive(), STEP_S, self._p)
        self._link.send(self._state, sensors, output)
        self._motors = output.motors

    def miss(self, seconds: float) -> None:
        """Stamps go on with the host's time: whoever maps the vehicle's clock onto it would take the gap for a delay."""
        self._state = self._state._replace(t_s=self._state.t_s + seconds)
