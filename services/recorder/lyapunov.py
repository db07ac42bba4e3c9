"""The paper's Lyapunov function of robot, cable and person, what changes it, and the energy that is truly stored.

| paper | here | unit | frame |
|---|---|---|---|
| p_H, v_H, p_R, v_R | States | m, m/s | W |
| p_R^r, f_c^r | Regulation.p_R_r, f_c_r | m, N | W |
| e_R = p_R^r - p_R | | m | W |
| K_H = diag(k_H, k_H, 0) | k_H_N_per_m | N/m | |
| u_A' = u_A - K_H e_R - f_c^r | exogenous | N | W |
| B_A by axes | b_A | N s/m | |
| V, V̇ | V, rate | J, W | |

Source: Thm 1 to 4 with E2 and E3. V = ½ (m_H v_H² + v_Rᵀ M_A v_R + e_Rᵀ K_H e_R) + ∫ t_c - l_cᵀ f_c^r + V_0, the integral
from l̄ and V_0 = ‖f_c^r‖²/(2 k_c) + l̄ ‖f_c^r‖, so that V = 0 at the equilibrium; V̇ = -dissipated + u_A'ᵀ v_R + u_Hᵀ v_H.
Added: a cable with damping, which the paper has none of, dissipates too. All broadcast over leading axes.
"""

from typing import NamedTuple

import numpy as np

from services import cable
from services.cable import Cable
from services.physics import Array, norm

_XY = np.array([1.0, 1.0, 0.0])


class States(NamedTuple):
    """Hand and robot, each (..., 3)."""

    p_H: Array
    v_H: Array
    p_R: Array
    v_R: Array


class Regulation(NamedTuple):
    """The pair of virtual robot and person, the cable between them, and where V is zero: p_R^r, f_c^r (3,)."""

    m_H_kg: float
    b_H_Ns_per_m: float
    M_A_kg: float
    k_H_N_per_m: float
    cable: Cable
    p_R_r: Array
    f_c_r: Array


class Dissipated(NamedTuple):
    """Power in W, (...), that the person's, the robot's and the cable's damping take."""

    person_W: Array
    robot_W: Array
    cable_W: Array

    @property
    def total_W(self) -> Array:
        """All of it."""
        return self.person_W + self.robot_W + self.cable_W


def V(x: States, p: Regulation) -> Array:
    """V in J, (...): never negative, and 0 at the equilibrium only."""
    l_c, spring = x.p_R - x.p_H, p.k_H_N_per_m * _XY * (p.p_R_r - x.p_R) ** 2
    f = float(norm(p.f_c_r))
    V_0 = f**2 / (2.0 * p.cable.k_c_N_per_m) + p.cable.rest_length_m * f
    return stored(x, p) + 0.5 * np.sum(spring, axis=-1) - l_c @ p.f_c_r + V_0


def stored(x: States, p: Regulation) -> Array:
    """Kinetic energy of person and virtual mass and the cable's elastic energy in J, (...)."""
    kinetic = 0.5 * np.sum(p.m_H_kg * x.v_H**2 + p.M_A_kg * x.v_R**2, axis=-1)
    return kinetic + cable.energy(norm(x.p_R - x.p_H), p.cable)


def exogenous(u_A: Array, p_R: Array, p: Regulation) -> Array:
    """u_A' in N, (..., 3): what u_A is more than regulation to p_R^r, f_c^r at the robot `p_R`."""
    return u_A - p.k_H_N_per_m * _XY * (p.p_R_r - p_R) - p.f_c_r


def dissipated(x: States, b_A: Array, p: Regulation) -> Dissipated:
    """By the three dampings; `b_A` (..., 3) N s/m is the filter's, by axes."""
    l_c, length = x.p_R - x.p_H, norm(x.p_R - x.p_H)
    stretching = np.sum(l_c * (x.v_R - x.v_H), axis=-1) / np.maximum(length, 1e-9)  # E9
    elastic = p.cable.k_c_N_per_m * np.maximum(length - p.cable.rest_length_m, 0.0)
    return Dissipated(
        p.b_H_Ns_per_m * np.sum(x.v_H**2, axis=-1),
        np.sum(b_A * x.v_R**2, axis=-1),
        (cable.tension(length, stretching, p.cable) - elastic) * stretching,
    )


def rate(x: States, b_A: Array, u_A: Array, u_H: Array, p: Regulation) -> Array:
    """V̇ in W, (...), as Thm 2 to 4 predict it of the filter's whole u_A and the person's u_H, each (..., 3) N."""
    supplied = np.sum(exogenous(u_A, x.p_R, p) * x.v_R + u_H * x.v_H, axis=-1)
    return supplied - dissipated(x, b_A, p).total_W
