"""The maneuver η: which force the hand shall feel at s, and where the robot is when it does.

| paper | here | unit | frame |
|---|---|---|---|
| f_xy(s) | f_xy | N | |
| f^d(s) = f_xy(s) t̂(s) + f_z z | f_d | N | W |
| p_R^d(s) = p_H^d(s) + f^d (1/k_c + l̄/‖f^d‖) | p_R_d | m | W |

Source: the paper's maneuver and maneuver regulation, with E6: p_R^d follows from p_H^d and f^d. Broadcasts over s
(...).
"""

import numpy as np

from services import cable
from services.guiding_controller.path import Path, Trapezoid
from services.physics import Array


def f_xy(s: Array, profile: Trapezoid) -> Array:
    """Horizontal pull along the path in N, (...): a trapezoid, positive for every s < 1 and 0 at s = 1."""
    rise = profile.f_max_N - profile.f_start_N
    up = profile.f_start_N + rise * np.clip(s / max(profile.ramp_up_fraction, 1e-9), 0.0, 1.0)
    down = profile.f_max_N * np.clip((1.0 - s) / profile.ramp_down_fraction, 0.0, 1.0)
    return np.minimum(up, down)


def f_d(s: Array, path: Path, f_z_N: float) -> Array:
    """f^d(s), the cable force wanted on the handle in N, (..., 3)."""
    force = f_xy(s, path.force)[..., None] * path.t_hat(s)
    force[..., 2] = f_z_N
    return force


def p_R_d(s: Array, path: Path, f_z_N: float, p: cable.Cable) -> Array:
    """p_R^d(s), where a resting robot carries f^d(s) from p_H^d(s), in m, (..., 3)."""
    return path.p(s) + cable.offset(f_d(s, path, f_z_N), p)
