"""The robot of a campaign: what pulls at the upper end of the cable, for many people at once.

| paper | here | unit | frame |
|---|---|---|---|
| p_R, v_R | Robot.p_W, Robot.v_W | m, m/s | W |
| f_c, on the handle; the robot feels -f_c | f_c | N | W |

The walk tells the robot its command 100 times a second and moves it 1000 times a second; what it makes of both is its own
affair. `Ideal` is the paper's robotModel: it is wherever the admittance filter's reference is. `Px4Like` lags and is pushed.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from services.config import Config
from services.physics import Array, Scalar, anywhere
from services.px4_bridge import admittance
from services.px4_bridge.admittance import Admittance, Command, Held
from services.simulator import tethered
from services.simulator.flight import SUBSTEPS

STEP_S = 0.001


class Robot(Protocol):
    """One robot for each person."""

    @property
    def p_W(self) -> Array:
        """Where it is, (..., 3) m."""
        ...

    @property
    def v_W(self) -> Array:
        """How fast it moves, (..., 3) m/s."""
        ...

    def obey(self, command: Command, slack: Scalar) -> None:
        """Take the command that holds from now on, and whether motion capture sees a slack cable, (...)."""
        ...

    def step(self, f_c: Array) -> None:
        """Move on by 1 ms under the cable's force on the handle, (..., 3) N."""
        ...


class Ideal:
    """The admittance filter's reference, tracked without error."""

    def __init__(self, p_W: Array, z_max_m: Scalar, p: Admittance) -> None:
        self._state = admittance.Moved(p_W, np.zeros_like(p_W), admittance.LONG_S)
        self._z_max_m, self._p = z_max_m, p
        at_rest = admittance.literal(np.zeros_like(p_W))
        self._held = Held(at_rest, STEP_S, p)
        self._slack: Scalar = False

    @property
    def p_W(self) -> Array:
        """Where it is, m."""
        return self._state.p

    @property
    def v_W(self) -> Array:
        """How fast it moves, m/s."""
        return self._state.v

    def obey(self, command: Command, slack: Scalar) -> None:
        """See Robot."""
        self._held = Held(command, STEP_S, self._p, self._held)
        self._slack = anywhere(slack) and slack

    def step(self, f_c: Array) -> None:
        """See Robot."""
        self._state = admittance.move(self._state, f_c, self._held, self._slack, self._z_max_m)


class Px4Like:
    """A PX4-like vehicle under observer, filter and set-point, as they fly it (simulator/tethered.py); ticks of 4 ms.

    The accelerometers of all people make the same noise, so that nobody's walk depends on who else walks.
    """

    def __init__(self, p_W: Array, z_max_m: Scalar, filter_: Admittance, config: Config) -> None:
        self._p = tethered.Robot(config.vehicle, filter_, config.force_estimator.observer, z_max_m=z_max_m)
        self._state = tethered.hovering(p_W, np.zeros(3), self._p)
        self._command, self._slack = admittance.literal(np.zeros_like(p_W)), False
        self._noise, self._steps = np.random.default_rng(config.system.seed), 0

    @property
    def p_W(self) -> Array:
        """Where it is, m."""
        return self._state.flight.robot.p_W

    @property
    def v_W(self) -> Array:
        """How fast it moves, m/s."""
        return self._state.flight.robot.v_W

    def obey(self, command: Command, slack: Scalar) -> None:
        """See Robot."""
        self._command, self._slack = command, slack

    def step(self, f_c: Array) -> None:
        """See Robot."""
        if self._steps % SUBSTEPS == 0:
            normal = np.broadcast_to(self._noise.standard_normal(3), f_c.shape)
            self._state = tethered.tick(self._state, -f_c, self._command, self._slack, normal, self._p)
        self._state = tethered.move(self._state, -f_c, self._p)
        self._steps += 1


Maker = Callable[[Array, Scalar, Admittance, Config], Robot]
"""From the place where it starts, its ceiling in m, the filter's parameters (both may be one for each person) and the profile."""

ROBOTS: dict[str, Maker] = {
    "ideal": lambda p_W, z_max_m, filter_, _: Ideal(p_W, z_max_m, filter_),
    "px4": Px4Like,
}
