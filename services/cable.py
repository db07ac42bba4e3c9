"""The cable: a unilateral spring along its own line, seen by the simulator and by everyone who reasons about it.

| paper | here | unit | frame |
|---|---|---|---|
| l_c = p_R - p_H | l_c | m | W |
| t_c(‖l_c‖) | tension | N | |
| f_c, force on the handle, towards the robot | force | N | W |
| k_c, l̄ | k_c_N_per_m, rest_length_m | N/m, m | |

Source: Tognon, Alami, Siciliano (T-RO 2021), cableForce and cableForceIntensity, and the last remark. All functions
broadcast over leading axes: vectors are (..., 3), lengths (...).
"""

import numpy as np

from services.parameters import NonNegative, Positive, parameters
from services.physics import Array, Scalar, at_least, components, vector

_TINY_M2 = 1e-30  # so that a cable of no length has no direction


@parameters
class Cable:
    """Rest length l̄, stiffness k_c and a little damping d_c along the line (the paper has none)."""

    rest_length_m: Positive
    k_c_N_per_m: Positive
    d_c_Ns_per_m: NonNegative = 0.0


def tension(length_m: Scalar, length_rate_mps: Scalar, p: Cable) -> Scalar:
    """t_c in N, (...): Hooke's law with damping while taut, 0 while slack; it never pushes."""
    stretch = length_m - p.rest_length_m
    pull = p.k_c_N_per_m * stretch + p.d_c_Ns_per_m * length_rate_mps
    return at_least(pull, 0.0) * (stretch > 0.0)


def force(p_R: Array, p_H: Array, v_R: Array, v_H: Array, p: Cable) -> Array:
    """f_c on the handle in N, (..., 3); the robot feels -f_c."""
    x, y, z = components(p_R - p_H)
    v_x, v_y, v_z = components(v_R - v_H)
    length = (x * x + y * y + z * z + _TINY_M2) ** 0.5
    rate = (x * v_x + y * v_y + z * v_z) / length  # E9: the paper prints ‖v_R - v_H‖
    pull = tension(length, rate, p) / length
    return vector(pull * x, pull * y, pull * z)


def offset(f_c: Array, p: Cable) -> Array:
    """l_c of a resting cable that carries f_c ≠ 0: f_c (1/k_c + l̄/‖f_c‖), (..., 3) m (regulation)."""
    x, y, z = components(f_c)
    per_N = 1.0 / p.k_c_N_per_m + p.rest_length_m / (x * x + y * y + z * z) ** 0.5
    return vector(per_N * x, per_N * y, per_N * z)


def hand(p_R: Array, f_c: Array, p: Cable) -> Array:
    """p_H of a taut cable from the robot and the force alone, (..., 3) m (last remark)."""
    return p_R - offset(f_c, p)


def energy(length_m: Array, p: Cable) -> Array:
    """∫ t_c from l̄ to ‖l_c‖, the spring's stored energy in J, (...)."""
    stretch = np.maximum(length_m - p.rest_length_m, 0.0)
    return 0.5 * p.k_c_N_per_m * stretch**2
