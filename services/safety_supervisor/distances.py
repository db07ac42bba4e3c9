"""How near the vehicle is to the person, and where it may be: what the supervisor's rules measure.

| here | meaning | unit | frame |
|---|---|---|---|
| p_R, p_H | vehicle's centre, hand | m | W |
| ahead | the way the person faces, as far as the cable and the hand's motion tell | | W, horizontal |

The head is not tracked. It is assumed where the person of the profile carries it: behind the hand, seen from the drone that
leads, and above it (G10). Broadcasts over leading axes.
"""

from typing import NamedTuple

from services.parameters import NonNegative, Positive, parameters
from services.physics import Array, Components, Scalar, at_least, choose, components, vector

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

    head: Scalar
    hand: Scalar
    outside: Scalar
    above: Scalar


def facing(ahead: Array, p_R: Array, p_H: Array) -> Array:
    """The way the person faces, (..., 3): towards the drone while it leads, as before while it is overhead."""
    (x, y, _), (ahead_x, ahead_y, ahead_z) = components(p_R - p_H), components(ahead)
    lead = (x * x + y * y) ** 0.5
    leads, distance = lead > TURN_M, at_least(lead, 1e-9)
    return vector(
        choose(leads, x / distance, ahead_x), choose(leads, y / distance, ahead_y), choose(leads, 0.0, ahead_z)
    )


def measure(
    p_R: Array, p_H: Array, ahead: Array, volume_min: Array, volume_max: Array, ceiling_m: float, p: Envelope
) -> Distances:
    """All clearances at once."""
    x, y, z = l_c = components(p_R - p_H)
    ahead_x, ahead_y, ahead_z = (p.head_behind_hand_m * part for part in components(ahead))
    head = x + ahead_x, y + ahead_y, z + ahead_z - p.head_above_hand_m
    outside, *walls = (*components(volume_min - p_R), *components(p_R - volume_max))
    for wall in walls:
        outside = at_least(outside, wall)
    return Distances(_length(head) - p.rotor_tip_m, _length(l_c), outside, components(p_R)[2] - ceiling_m)


def _length(v: Components) -> Scalar:
    return sum(x * x for x in v) ** 0.5
