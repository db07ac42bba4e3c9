"""From the admittance filter to what PX4 is told: position, velocity and acceleration, one sample, within limits.

| paper | here | unit | frame |
|---|---|---|---|
| u_R | state.a | m/s² | W |
| f̂_c (on the handle) | f_c | N | W |
| m_R, mass of the vehicle | m_R_kg | kg | |

The robot feels -f_c, so PX4 must push +f_c/m_R to move as if there were no cable: a_sp = u_R + ff f̂_c/m_R (G2, G5).
Both terms come from the same sample; a late f̂_c is felt as a delay in the loop. `ff` is ramped by the caller (G9).
Broadcasts.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from services.parameters import Positive, parameters
from services.physics import Array, saturate
from services.px4_bridge.admittance import State


@parameters
class Limits:
    """Largest set-points; horizontal parts are shortened with their direction kept."""

    a_xy_max_mps2: Positive
    a_z_max_mps2: Positive
    v_max_mps: Positive
    step_max_m: Positive


class Setpoint(NamedTuple):
    """p in m, v in m/s, a in m/s², all (..., 3); whether a limit changed any of them, (...)."""

    p: Array
    v: Array
    a: Array
    limited: NDArray[np.bool_]


def setpoint(state: State, f_hat_c: Array, m_R_kg: float, ff: ArrayLike, p_last: Array, limits: Limits) -> Setpoint:
    """The set-point of this tick; `p_last` is the position sent before, from which it moves at most `step_max_m`."""
    a_wanted = state.a + np.asarray(ff)[..., None] * f_hat_c / m_R_kg
    a = _limited_acceleration(a_wanted, limits)
    v = saturate(state.v, limits.v_max_mps)
    p = p_last + saturate(state.p - p_last, limits.step_max_m)
    change = np.abs(a - a_wanted) + np.abs(v - state.v) + np.abs(p - state.p)
    return Setpoint(p, v, a, np.max(change, axis=-1) > 1e-9)


def _limited_acceleration(a: Array, limits: Limits) -> Array:
    up = np.clip(a[..., 2:], -limits.a_z_max_mps2, limits.a_z_max_mps2)
    return np.concatenate((saturate(a[..., :2], limits.a_xy_max_mps2), up), axis=-1)
