"""The maneuver η: which force the hand shall feel at s, and where the robot is when it does.

| paper | here | unit | frame |
|---|---|---|---|
| f_xy(s) | f_xy | N | |
| f^d(s) = f_xy(s) t̂(s) + f_z z | f_d | N | W |
| p_R^d(s) = p_H^d(s) + f^d (1/k_c + l̄/‖f^d‖) | p_R_d | m | W |

Source: the paper's maneuver and maneuver regulation, with E6: p_R^d follows from p_H^d and f^d. Broadcasts over s
(...).
"""

from typing import NamedTuple

import numpy as np

from services import cable
from services.guiding_controller.path import Path, Trapezoid
from services.physics import Array, Scalar, choose, clamp, components, vector


class Point(NamedTuple):
    """η at s: p_H^d in m, f^d in N and p_R^d in m, each (..., 3)."""

    p_H_d: Array
    f_d: Array
    p_R_d: Array


def at(s: Scalar, path: Path, f_z_N: float, p: cable.Cable) -> Point:
    """All of η(s); a robot that rests at p_R^d carries f^d from p_H^d."""
    p_H_d, t_hat = path.p_and_t_hat(s)
    force = _force(s, t_hat, path.force, f_z_N)
    return Point(p_H_d, force, p_H_d + cable.offset(force, p))


def f_xy(s: Scalar, profile: Trapezoid) -> Scalar:
    """Horizontal pull along the path in N, (...): a trapezoid, positive for every s < 1 and 0 at s = 1."""
    rise = profile.f_max_N - profile.f_start_N
    up = profile.f_start_N + rise * clamp(s / max(profile.ramp_up_fraction, 1e-9), 0.0, 1.0)
    down = profile.f_max_N * clamp((1.0 - s) / profile.ramp_down_fraction, 0.0, 1.0)
    return choose(up < down, up, down)


def f_d(s: Scalar, path: Path, f_z_N: float) -> Array:
    """f^d(s), the cable force wanted on the handle in N, (..., 3)."""
    return _force(s, path.t_hat(s), path.force, f_z_N)


def work(path: Path) -> float:
    """Of f_xy along the whole path, in J: what the walk takes out of the guidance, whoever walks."""
    s = np.linspace(0.0, 1.0, 1001)
    return path.length_m * float(np.trapezoid(f_xy(s, path.force), s))


def p_R_d(s: Scalar, path: Path, f_z_N: float, p: cable.Cable) -> Array:
    """p_R^d(s) in m, (..., 3)."""
    return at(s, path, f_z_N, p).p_R_d


def _force(s: Scalar, t_hat: Array, profile: Trapezoid, f_z_N: float) -> Array:
    pull, (x, y, _) = f_xy(s, profile), components(t_hat)
    return vector(pull * x, pull * y, f_z_N)
