"""Which poses of the robot may reach the autopilot: those that follow from the last ones, and in flight no new beginning.

An autopilot rejects a jump of its poses for a second or two, then believes it and flies after it (PX4: 1.5 s). So a pose
that does not follow from the last ones is kept from it, in position and in attitude. On the ground the tracker begins anew
where it sees the robot after `lost_s`. In flight it does so only where the autopilot itself, by its inertial sensors,
believes the vehicle to be; a frame of reference that has moved is refused until somebody lands, and the supervisor does.
"""

from typing import NamedTuple

import numpy as np

from services.parameters import Positive, parameters
from services.physics import Array, Scalar, dot, norm
from services.tracker import filtering


@parameters
class Robot:
    """Filter of the position, gate of the attitude, and how far the autopilot's own belief may be from what is seen."""

    motion: filtering.Filter
    turn_rad: Positive
    turn_rad_s: Positive
    """The gate opens by this while the robot is not seen: it can turn."""
    belief_m: Positive
    belief_mps: Positive
    """The autopilot's belief drifts while the robot is not seen."""
    belief_rad: Positive


class Belief(NamedTuple):
    """The autopilot's own position (m, (3,)) and attitude (w first, (4,)), and whether it flies by them."""

    p: Array
    q_WB_wxyz: Array
    flying: bool


class State(NamedTuple):
    """The position's filter, and the last attitude that was believed, w first, (4,)."""

    motion: filtering.State
    q_WB_wxyz: Array


def start() -> State:
    """Nothing seen yet."""
    return State(filtering.start(), np.array([1.0, 0.0, 0.0, 0.0]))


def step(
    state: State, z: Array, q_WB_wxyz: Array, measured: bool, belief: Belief, dt: float, p: Robot
) -> tuple[State, filtering.Output]:
    """One frame; what became of the pose is in the output's `sample`."""
    hidden_s = float(state.motion.hidden_s)
    follows = _angle(q_WB_wxyz, state.q_WB_wxyz) <= p.turn_rad + p.turn_rad_s * hidden_s
    there = float(norm(z - belief.p)) <= p.belief_m + p.belief_mps * hidden_s
    believed = not belief.flying or (there and _angle(q_WB_wxyz, belief.q_WB_wxyz) <= p.belief_rad)
    motion, output = filtering.step(state.motion, z, measured, dt, p.motion, follows=follows, may_restart=believed)
    taken = output.sample in (filtering.Sample.ACCEPTED, filtering.Sample.RESTART)
    return State(motion, q_WB_wxyz if taken else state.q_WB_wxyz), output


def _angle(a_wxyz: Array, b_wxyz: Array) -> Scalar:
    """Between two attitudes, rad."""
    return float(2.0 * np.arccos(min(abs(float(dot(a_wxyz, b_wxyz))), 1.0)))
