"""How near the vehicle is to the person, and where it may be: what the supervisor's rules measure.

| here | meaning | unit | frame |
|---|---|---|---|
| p_R, p_H | vehicle's centre, hand | m | W |
| ahead | the way the person faces, as far as the cable and the hand's motion tell | | W, horizontal |

The head is not tracked. It is assumed where the person of the profile carries it: behind the hand, seen from the drone that
leads, and above it (G10). Broadcasts over leading axes.
"""

from typing import NamedTuple

import numpy as np

from services.parameters import NonNegative, Positive, parameters
from services.physics import Array, norm

HORIZONTAL = np.array([1.0, 1.0, 0.0])
TURN_M = 0.25  # the drone must lead by this much before it says where the person faces


@parameters
class Envelope:
    """The person as the supervisor imagines them, and the vehicle's size."""

    head_above_hand_m: Positive
    head_behind_hand_m: NonNegative
    rotor_tip_m: Positive
    """From the vehicle's centre to the furthest rotor tip."""


class Distances(NamedTuple):
    """Clearances in m, (...); `outside` and `above` are negative where all is well."""

    head: Array
    hand: Array
    outside: Array
    above: Array


def facing(ahead: Array, p_R: Array, p_H: Array) -> Array:
    """The way the person faces, (..., 3): towards the drone while it leads, as before while it is overhead."""
    lead = (p_R - p_H) * HORIZONTAL
    distance = norm(lead)[..., None]
    return np.where(distance > TURN_M, lead / np.maximum(distance, 1e-9), ahead)


def measure(
    p_R: Array, p_H: Array, ahead: Array, volume_min: Array, volume_max: Array, ceiling_m: float, p: Envelope
) -> Distances:
    """All clearances at once."""
    head = p_H - p.head_behind_hand_m * ahead + np.array([0.0, 0.0, p.head_above_hand_m])
    outside = np.max(np.maximum(volume_min - p_R, p_R - volume_max), axis=-1)
    return Distances(norm(p_R - head) - p.rotor_tip_m, norm(p_R - p_H), outside, p_R[..., 2] - ceiling_m)
