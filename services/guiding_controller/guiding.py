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

from services.cable import Cable
from services.guiding_controller import maneuver
from services.guiding_controller.path import Path, project
from services.parameters import Positive, parameters
from services.physics import Array, Scalar, at_least, choose, clamp, components, scalar, vector

Flags = Scalar
"""A bool; of a crowd an array (...,) of them."""
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

    s: Scalar
    scale: Scalar


class Input(NamedTuple):
    """Hand and robot in m, (..., 3); whether the handle is held and guiding is asked for, (...)."""

    p_H: Array
    p_R: Array
    held: Flags
    guiding: Flags


class Guidance(NamedTuple):
    """What the bridge needs (p_R_d, f_d, scale), and what the record needs; units as in the table above."""

    s: Scalar
    s_nearest: Scalar  # the projection before the bound on its rate
    scale: Scalar  # of u_A,xy, 0 at once when nobody holds the handle
    p_H_d: Array
    p_R_d: Array
    f_d: Array
    u_A: Array
    e_H_m: Scalar  # ‖p_H^d(s*) - p_H‖, horizontal


def start(p_H: Array, path: Path) -> State:
    """s* by the global projection of the hand, nothing ramped in yet."""
    s = project(p_H, path)
    return State(s, 0.0 * s)


def step(state: State, x: Input, dt: float, path: Path, p: Guiding, cable: Cable) -> tuple[State, Guidance]:
    """One tick of maneuver regulation.

    s* moves, in either direction and at most at `s_rate_max_mps`, only while the handle is held in guiding. So does
    the ramp of the horizontal force; without a hand the force is zero at once.
    """
    active, last = x.held & x.guiding, scalar(state.s)
    s_nearest = project(x.p_H, path, last, p.window_m)
    bound = p.s_rate_max_mps * dt / path.length_m
    s = scalar(choose(active, last + clamp(s_nearest - last, -bound, bound), last))
    scale = choose(active, clamp(state.scale + dt / p.ramp_s, 0.0, 1.0), 0.0)
    wanted = maneuver.at(s, path, p.f_z_N, cable)
    u_A = paper_u_A(wanted.p_R_d, wanted.f_d, x.p_R, scale, p)
    e_x, e_y, _ = components(wanted.p_H_d - x.p_H)
    e_H = (e_x * e_x + e_y * e_y) ** 0.5
    return State(s, scale), Guidance(s, s_nearest, scale, wanted.p_H_d, wanted.p_R_d, wanted.f_d, u_A, e_H)


def paper_u_A(p_R_d: Array, f_d: Array, p_R: Array, scale: Scalar, p: Guiding) -> Array:
    """u_A = K_H sat(p_R^d - p_R) + f^d in N, (..., 3), its horizontal part times `scale` (...)."""
    (e_x, e_y, _), (f_x, f_y, f_z) = components(p_R_d - p_R), components(f_d)
    k = p.k_H_N_per_m / at_least((e_x * e_x + e_y * e_y) ** 0.5 / p.e_R_max_m, 1.0)
    return vector(scale * (k * e_x + f_x), scale * (k * e_y + f_y), f_z)
