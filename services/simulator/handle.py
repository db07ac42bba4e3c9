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

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from services.parameters import NonNegative, parameters
from services.physics import GRAVITY_MPS2, Z

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_XY = np.array([1.0, 1.0, 0.0])


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
    pull = f_c_W - p.drag_Ns_per_m * state.v_W
    v = state.v_W + dt * (pull / p.mass_kg - GRAVITY_MPS2 * Z)
    moved = HandleState(state.p_W + dt * v, v)
    return _floor(moved, state.p_W, dt, p) if np.any(_lies(moved, p)) else moved


def _lies(state: HandleState, p: Handle) -> Flags:
    return (state.p_W[..., 2] <= p.height_m) & (state.v_W[..., 2] <= 0.0)


def _floor(moved: HandleState, before_W: Array, dt: float, p: Handle) -> HandleState:
    """No bounce; Coulomb friction: the floor's impulse takes the fall, and at most `friction` times as much of the slide."""
    lies = _lies(moved, p)[..., None]
    slide = moved.v_W * _XY
    speed = np.sqrt((slide * slide).sum(-1, keepdims=True))
    keep = np.maximum(0.0, 1.0 + p.friction * moved.v_W[..., 2:] / np.maximum(speed, 1e-9))
    v = np.where(lies, slide * keep, moved.v_W)
    p_W = np.where(lies, before_W * _XY + dt * v + p.height_m * Z, moved.p_W)
    return HandleState(p_W, v)
