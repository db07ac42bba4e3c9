"""Maneuver regulation: from the hand's place to the force and the robot's place that lead it on.

| paper | here | unit | frame |
|---|---|---|---|
| s* | State.s | | |
| p_H, p_R | Input.p_H, Input.p_R | m | W |
| p_H^d(s*), p_R^d(s*) | Guidance.p_H_d, Guidance.p_R_d | m | W |
| f^d(s*) | Guidance.f_d | N | W |
| K_H = diag(k_H, k_H, 0) | k_H_N_per_m | N/m | |
| u_A | Guidance.u_A | N | W |

Source: the paper's maneuver regulation (E6) with the saturation of e_R and the ramp of G9, and s* bounded as in G6.
The spring that flies is the bridge's, on its own reference (G5b): it takes p_R^d, f^d and the scale. Guidance.u_A is
the paper's literal form on the measured robot, for the record and for comparison. Everything broadcasts over leading
axes.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from services.cable import Cable
from services.guiding_controller import maneuver
from services.guiding_controller.path import Path, project
from services.parameters import Positive, parameters
from services.physics import Array, norm, saturate

Flags = NDArray[np.bool_]
HORIZONTAL = np.array([1.0, 1.0, 0.0])


@parameters
class Guiding:
    """Gains and bounds of the maneuver regulation."""

    k_H_N_per_m: Positive
    f_z_N: Positive
    e_R_max_m: Positive
    ramp_s: Positive
    s_rate_max_mps: Positive
    window_m: Positive


class State(NamedTuple):
    """s* in [0, 1] and the ramp of u_A,xy in [0, 1], both (...)."""

    s: Array
    scale: Array


class Input(NamedTuple):
    """Hand and robot in m, (..., 3); whether the handle is held and guiding is asked for, (...)."""

    p_H: Array
    p_R: Array
    held: Flags
    guiding: Flags


class Guidance(NamedTuple):
    """What the bridge needs (p_R_d, f_d, scale), and what the record needs; units as in the table above."""

    s: Array
    s_nearest: Array  # the projection before the bound on its rate
    scale: Array  # of u_A,xy, 0 at once when nobody holds the handle
    p_H_d: Array
    p_R_d: Array
    f_d: Array
    u_A: Array
    e_H_m: Array  # ‖p_H^d(s*) - p_H‖, horizontal


def start(p_H: Array, path: Path) -> State:
    """s* by the global projection of the hand, nothing ramped in yet."""
    s = project(p_H, path)
    return State(s, np.zeros_like(s))


def step(state: State, x: Input, dt: float, path: Path, p: Guiding, cable: Cable) -> tuple[State, Guidance]:
    """One tick of maneuver regulation.

    s* moves, in either direction and at most at `s_rate_max_mps`, only while the handle is held in guiding. So does
    the ramp of the horizontal force; without a hand the force is zero at once.
    """
    active = x.held & x.guiding
    s_nearest = project(x.p_H, path, state.s, p.window_m)
    bound = p.s_rate_max_mps * dt / path.length_m
    s = np.where(active, state.s + np.clip(s_nearest - state.s, -bound, bound), state.s)
    scale = np.where(active, np.minimum(state.scale + dt / p.ramp_s, 1.0), 0.0)
    p_H_d, f_d = path.p(s), maneuver.f_d(s, path, p.f_z_N)
    p_R_d = maneuver.p_R_d(s, path, p.f_z_N, cable)
    u_A = paper_u_A(p_R_d, f_d, x.p_R, scale, p)
    e_H = norm((p_H_d - x.p_H) * HORIZONTAL)
    return State(s, scale), Guidance(s, s_nearest, scale, p_H_d, p_R_d, f_d, u_A, e_H)


def paper_u_A(p_R_d: Array, f_d: Array, p_R: Array, scale: Array, p: Guiding) -> Array:
    """u_A = K_H sat(p_R^d - p_R) + f^d in N, (..., 3), its horizontal part times `scale` (...)."""
    e_R = saturate((p_R_d - p_R) * HORIZONTAL, p.e_R_max_m)
    u_A = p.k_H_N_per_m * e_R + f_d
    u_A[..., :2] *= scale[..., None]
    return u_A
