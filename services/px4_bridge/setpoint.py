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

from services.parameters import Positive, parameters
from services.physics import Array, Components, Row, Scalar, at_least, clamp, components, exp, vector
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
    limited: Scalar


def ahead(state: State, b: Row, M_A_kg: Scalar, lead_s: Scalar) -> State:
    """The filter with the u_R that it will have `lead_s` from now under the same force, springs left out: u_R exp(-b t / M_A).

    So much later than a set-point does a vehicle's attitude follow it; without the lead a vehicle that is pulled runs on
    before it brakes with the filter. Horizontal only: thrust does not wait for the attitude. `b` is B_A by axes in N s/m.
    """
    x, y, z = components(state.a)
    fade_x, fade_y = (exp(-lead_s * b_i / M_A_kg) for b_i in b[:2])
    return state._replace(a=vector(fade_x * x, fade_y * y, z))


def setpoint(state: State, f_hat_c: Array, m_R_kg: float, ff: Scalar, p_last: Array, limits: Limits) -> Setpoint:
    """The set-point of this tick; `p_last` is the position sent before, from which it moves at most `step_max_m`."""
    last, forward = components(p_last), ff / m_R_kg
    a = [u + forward * f for u, f in zip(components(state.a), components(f_hat_c), strict=True)]
    step = [x - x_last for x, x_last in zip(components(state.p), last, strict=True)]
    a_xy, turned = _shortened(a[:2], limits.a_xy_max_mps2)
    a_z = clamp(a[2], -limits.a_z_max_mps2, limits.a_z_max_mps2)
    v, slowed = _shortened(components(state.v), limits.v_max_mps)
    moved, held_back = _shortened(step, limits.step_max_m)
    p = (x_last + x for x_last, x in zip(last, moved, strict=True))
    limited = turned + slowed + held_back + abs(a[2] - a_z) > 1e-9
    return Setpoint(vector(*p), vector(*v), vector(*a_xy, a_z), limited)


def _shortened(v: Components, limit: float) -> tuple[list[Scalar], Scalar]:
    """`v` with its direction kept and its length at most `limit`, and by how much it was longer."""
    length = sum(x * x for x in v) ** 0.5
    over = at_least(length / limit, 1.0)
    return [x / over for x in v], length - length / over
