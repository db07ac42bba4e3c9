"""The handle while nobody holds it: a small mass at the end of the cable, hanging, swinging, or lying on the floor.

| paper | here | unit | frame |
|---|---|---|---|
| p_H, v_H | p_W, v_W | m, m/s | W |
| f_c, force on the handle | f_c_W | N | W |
| weighed handle (G1: at most 50 g) | mass_kg | kg | |

The cable is stiff for so light a mass: sqrt(k_c/m) is 112 rad/s at 500 N/m and 40 g. Semi-implicit Euler keeps the energy
of the spring bounded while sqrt(k_c/m) dt < 2, and with the cable's damping d_c while also d_c dt/m is well below 1: at
dt = 1 ms both hold down to 5 g. Everything broadcasts over leading axes.
"""

from typing import Annotated, NamedTuple

from annotated_types import Ge, Le

from services.parameters import NonNegative, parameters
from services.physics import GRAVITY_MPS2, Array, Components, Scalar, anywhere, at_least, choose, components, vector


@parameters
class Handle:
    """A point mass with a little air drag; `height_m` is its centre's height when it lies on the floor."""

    mass_kg: Annotated[float, Ge(0.005), Le(0.05)]
    drag_Ns_per_m: NonNegative
    height_m: NonNegative
    friction: NonNegative


class HandleState(NamedTuple):
    """Position and velocity in the world, (..., 3)."""

    p_W: Array
    v_W: Array


def step(state: HandleState, f_c_W: Array, dt: float, p: Handle) -> HandleState:
    """One step under the cable's force `f_c_W` (..., 3) N, semi-implicit Euler, then the floor; dt up to 1 ms."""
    f_x, f_y, f_z = components(f_c_W)
    v_x, v_y, v_z = components(state.v_W)
    gain, drag = dt / p.mass_kg, p.drag_Ns_per_m
    v = v_x + gain * (f_x - drag * v_x), v_y + gain * (f_y - drag * v_y), v_z + gain * (f_z - drag * v_z - _weight_N(p))
    x, y, z = components(state.p_W)
    moved = x + dt * v[0], y + dt * v[1], z + dt * v[2]
    lies = (moved[2] <= p.height_m) & (v[2] <= 0.0)
    if anywhere(lies):
        v = _slowed(v, lies, p)
        moved = x + dt * v[0], y + dt * v[1], choose(lies, p.height_m, moved[2])
    return HandleState(vector(*moved), vector(*v))


def _weight_N(p: Handle) -> float:
    return p.mass_kg * GRAVITY_MPS2


def _slowed(v: Components, lies: Scalar, p: Handle) -> tuple[Scalar, Scalar, Scalar]:
    """No bounce; Coulomb friction: the floor's impulse takes the fall, and at most `friction` times as much of the slide."""
    v_x, v_y, v_z = v
    speed = (v_x * v_x + v_y * v_y) ** 0.5
    keep = choose(lies, at_least(1.0 + p.friction * v_z / at_least(speed, 1e-9), 0.0), 1.0)
    return v_x * keep, v_y * keep, choose(lies, 0.0, v_z)
