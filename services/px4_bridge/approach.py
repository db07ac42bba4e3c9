"""Position mode: the reference moves to a goal with bounded speed and acceleration, wherever it starts from.

| here | meaning | unit | frame |
|---|---|---|---|
| p, v | the reference | m, m/s | W |
| goal | where it shall come to rest | m | W |

The wanted speed falls with the square root of the distance, so the reference brakes at `a_max_mps2` and does not overshoot;
near the goal the fall is linear, so it comes to rest. Broadcasts over leading axes.
"""

from typing import NamedTuple

import numpy as np

from services.parameters import Positive, parameters
from services.physics import Array, norm, saturate


@parameters
class Approach:
    """Braking acceleration, largest acceleration, and the pace of the last centimetres."""

    a_max_mps2: Positive
    rate_per_s: Positive


class State(NamedTuple):
    """Position and velocity of the reference, (..., 3)."""

    p: Array
    v: Array


def step(state: State, goal: Array, speed_mps: float, dt: float, p: Approach) -> tuple[State, Array]:
    """One tick towards `goal` (..., 3); returns the reference and its acceleration in m/s², (..., 3)."""
    to_go = goal - state.p
    distance = norm(to_go)[..., None]
    # rate r and braking a meet with equal slope at the distance a / r²
    knee = p.a_max_mps2 / p.rate_per_s**2
    braking = np.sqrt(np.maximum(2.0 * p.a_max_mps2 * distance - p.a_max_mps2 * knee, 0.0))
    speed = np.minimum(speed_mps, np.where(distance < knee, p.rate_per_s * distance, braking))
    wanted = speed * to_go / np.maximum(distance, 1e-9)
    a = saturate((wanted - state.v) / dt, 2.0 * p.a_max_mps2)
    v = state.v + a * dt
    return State(state.p + v * dt, v), a
