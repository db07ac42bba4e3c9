"""The wrench observer, its force half: what pulls at the vehicle besides its own thrust and its weight.

| paper | here | unit | frame |
|---|---|---|---|
| a_imu, specific force | a_B | m/s² | B (FLU) |
| R | q_WB_wxyz | | B to W |
| T | thrust_N, along +z of the body | N | B |
| f_ext, on the robot | State.f_ext | N | W |
| f̂_c = -f_ext, on the handle | f_c | N | W |

Source: Ryll et al. 2017 as the paper uses it: f_ext is the low-passed R(m a_imu - T e_3). Specific force has no
gravity in it, so neither has the difference. The low-pass is stepped exactly for an input held over dt. Broadcasts
over leading axes.
"""

from typing import NamedTuple

import numpy as np

from services.parameters import Positive, parameters
from services.physics import Array, Scalar, components, rotate, scalar, vector


@parameters
class Observer:
    """Mass that the IMU moves with, and the -3 dB bandwidth of the low-pass."""

    m_R_kg: Positive
    bandwidth_Hz: Positive


class State(NamedTuple):
    """Low-passed external force on the robot in N, W, (..., 3)."""

    f_ext: Array


def start(shape: tuple[int, ...] = ()) -> State:
    """No force yet; after 1/bandwidth the start is forgotten (to 0.2 %)."""
    return State(np.zeros((*shape, 3)))


def raw(a_B: Array, q_WB_wxyz: Array, thrust_N: Scalar, m_R_kg: float) -> Array:
    """R (m a_imu - T e_3) in N, W, (..., 3)."""
    x, y, z = components(a_B)
    return rotate(q_WB_wxyz, vector(m_R_kg * x, m_R_kg * y, m_R_kg * z - thrust_N))


def step(state: State, a_B: Array, q_WB_wxyz: Array, thrust_N: Scalar, dt: Scalar, p: Observer) -> tuple[State, Array]:
    """One IMU sample, `dt` s after the last; returns the state and f̂_c on the handle in N, W, (..., 3)."""
    gain = 1.0 - scalar(np.exp(-2.0 * np.pi * p.bandwidth_Hz * dt))
    now = components(raw(a_B, q_WB_wxyz, thrust_N, p.m_R_kg))
    f_ext = vector(*(f + gain * (new - f) for f, new in zip(components(state.f_ext), now, strict=True)))
    return State(f_ext), -f_ext
