"""Whether a capture system's world and its robot body are as frames.py has them, judged before anything moves.

Positions alone cannot tell which axis is up, nor can one attitude: systems call the pose in which a body was defined the
identity, whatever their axes are. But before a flight both bodies lie on the floor, which is z = 0. Two bodies that lie
still near y = 0, away from z = 0, lie on the floor of a system whose y is up. And a vehicle that stands on the floor stands
level, so its body's z axis points up. Nothing is judged once the vehicle is armed; what was right stays right.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from services.parameters import Positive, parameters
from services.physics import Array, dot, norm, rotate

UP = np.array([0.0, 0.0, 1.0])


class Verdict(IntEnum):
    """What is known of the axes."""

    UNKNOWN = 0  # nothing has lain still on a floor yet
    RIGHT = 1
    Y_UP = 2
    TILTED = 3  # the robot's body was not defined level


@parameters
class Axes:
    """What counts as lying on the floor."""

    floor_m: Positive
    """This near to the floor, marker offset and landing gear included."""
    still_m: Positive
    """This little from where they came to rest."""
    still_s: Positive
    tilt_max_rad: Positive


class State(NamedTuple):
    """Where both bodies came to rest, m, (2, 3), for how long they have, and what was found."""

    rest: Array
    still_s: float
    verdict: Verdict


def start() -> State:
    """Nothing seen."""
    return State(np.full((2, 3), np.inf), 0.0, Verdict.UNKNOWN)


def step(state: State, bodies: Array, q_WB_wxyz: Array, dt: float, p: Axes) -> State:
    """One frame with both bodies, robot first, (2, 3); `q_WB_wxyz` is the robot's."""
    if state.verdict is Verdict.RIGHT:
        return state
    if not np.all(norm(bodies - state.rest) < p.still_m):
        return State(bodies, 0.0, state.verdict)
    still_s = state.still_s + dt
    return state._replace(
        still_s=still_s, verdict=_judge(bodies, q_WB_wxyz, p) if still_s >= p.still_s else state.verdict
    )


def _judge(bodies: Array, q_WB_wxyz: Array, p: Axes) -> Verdict:
    on_floor = np.all(np.abs(bodies) < p.floor_m, axis=0)
    if on_floor[2]:
        tilt = np.arccos(np.clip(dot(rotate(q_WB_wxyz, UP), UP), -1.0, 1.0))
        return Verdict.RIGHT if tilt <= p.tilt_max_rad else Verdict.TILTED
    return Verdict.Y_UP if on_floor[1] else Verdict.UNKNOWN


def complaint(state: State) -> str:
    """What is wrong, and what to do; empty where nothing is known to be."""
    (_, y_R, z_R), (_, y_H, z_H) = state.rest
    if state.verdict is Verdict.Y_UP:
        where = f"y = {y_R:.2f} and {y_H:.2f} m, z = {z_R:.2f} and {z_H:.2f} m"
        cure = "let it stream with z up, or take them off the table: the floor is z = 0"
        return f"the capture system's y axis is up: robot and handle lie still at {where}; {cure}"
    if state.verdict is Verdict.TILTED:
        return "the robot's body stands tilted on the floor: define it anew with the vehicle level, x forward and z up"
    return ""
