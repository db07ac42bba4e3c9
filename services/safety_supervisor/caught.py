"""Is the cable caught? It hangs the handle higher than it is long; and unlike a hand that lifts it, it goes on carrying it.

| paper | here | unit | frame |
|---|---|---|---|
| l_c = p_R - p_H, and its rate | l_c, dl_c | m, m/s | W |
| f̂_c | f_c, bias removed | N | W |

A handle that is nearer than the cable is long pushes the vehicle ahead of it, as a hand would that is lifted towards the
propellers (px4_bridge/leash.py). A caught one goes with the vehicle, which so climbs until the handle is out of reach. The
force is noisy while the vehicle accelerates: what counts is its mean. Everything broadcasts over leading axes.
"""

import math
from typing import NamedTuple

from services.physics import Array, Scalar, at_least, choose, components, scalar

MEAN_S = 0.3
CARRIES = 0.5  # of the handle's weight; in a hand the cable carries nothing of it
LIFTED_MPS = 0.3  # towards the vehicle: a hand, whatever the force says in the same moment


class State(NamedTuple):
    """What the cable carries upwards in N on average, (...)."""

    carried_N: Scalar = 0.0


def step(
    state: State, l_c: Array, dl_c: Array, f_c: Array, dt: float, rest_length_m: float, weight_N: float
) -> tuple[State, Scalar]:
    """Advance by `dt` s; returns the state and by how many m a caught cable is short, (...), 0 where none is caught."""
    (x, y, z), (v_x, v_y, v_z), f_z = components(l_c), components(dl_c), components(f_c)[2]
    before = scalar(state.carried_N)
    carried_N = before + (1.0 - math.exp(-dt / MEAN_S)) * (f_z - before)
    length_m = at_least((x * x + y * y + z * z) ** 0.5, 1e-9)
    closing_mps = -(x * v_x + y * v_y + z * v_z) / length_m
    caught = (carried_N > CARRIES * weight_N) & (closing_mps < LIFTED_MPS)
    return State(carried_N), choose(caught, at_least(rest_length_m - length_m, 0.0), 0.0)
