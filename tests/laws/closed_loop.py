"""The closed loop of Thm 1 to 4: robot, cable and person in the plane under regulation, with any parameters.

A state x is p_H, v_H, p_R, v_R, (..., 12). Parameters are floats, or arrays (...) of a batch. V and what changes it stand here
alone, so that every test of the theorems speaks of the same V.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from services import cable
from services.physics import GRAVITY_MPS2, Array, Components, Scalar, norm

GOAL = np.array([0.4, -0.3, 0.0])
XY = np.array([1.0, 1.0, 0.0])
NOTHING = (0.0, 0.0, 0.0)
Inputs = Callable[[float], tuple[Components, Components]]
"""u_A'(t) and u_H(t), three components each; u_H is horizontal."""


class Loop(NamedTuple):
    """Person, filter, force and cable."""

    m_H: Scalar
    b_H: Scalar
    M_A: Scalar
    b_A: Scalar
    k_H: Scalar
    f_z: Scalar
    k_c: Scalar
    rest: Scalar

    @property
    def cable(self) -> cable.Cable:
        """Without damping, as the paper's."""
        return cable.Cable(rest_length_m=cast(float, self.rest), k_c_N_per_m=cast(float, self.k_c))


def equilibrium(p: Loop) -> Array:
    """x̄ (..., 12): the hand at the goal, the robot above it (E1)."""
    height = np.asarray(p.rest + p.f_z / p.k_c)
    x = np.zeros((*height.shape, 12))
    x[..., 0:3] = x[..., 6:9] = GOAL
    x[..., 8] = height
    return x


def flow(x: Components, p: Loop, u_R: Components = NOTHING, u_H: Components = NOTHING) -> list[Scalar]:
    """ẋ in components, of floats as of arrays: closedLoopSystemDyn; the ground keeps the hand's height."""
    h, v_h, r, v_r = x[0:3], x[3:6], x[6:9], x[9:12]
    l_c = [b - a for a, b in zip(h, r, strict=True)]
    length = (l_c[0] ** 2 + l_c[1] ** 2 + l_c[2] ** 2) ** 0.5
    pull = cable.tension(length, 0.0 * length, p.cable) / (length + 1e-300)
    a_h = [(pull * l_c[i] + u_H[i] - p.b_H * v_h[i]) / p.m_H for i in (0, 1)]
    spring = [p.k_H * (GOAL[0] - r[0]), p.k_H * (GOAL[1] - r[1]), p.f_z]
    a_r = [(spring[i] + u_R[i] - p.b_A * v_r[i] - pull * l_c[i]) / p.M_A for i in range(3)]
    return [*v_h, *a_h, 0.0 * length, *v_r, *a_r]


def V(x: NDArray[Any], p: Loop) -> NDArray[Any]:
    """V of Thm 1 with E2 in J, (...): the integral from l̄, V_0 = f_z²/(2 k_c) + l̄ f_z.

    Analytic on the slack set and on the taut one, so x may be complex for a complex step.
    """
    h, v_h, r, v_r = np.split(x, 4, axis=-1)
    l_c, e = r - h, (GOAL - r) * XY
    kinetic = 0.5 * (p.m_H * (v_h**2).sum(-1) + p.M_A * (v_r**2).sum(-1) + p.k_H * (e**2).sum(-1))
    V_0 = p.f_z**2 / (2.0 * p.k_c) + p.rest * p.f_z
    return kinetic + cable.energy(norm(l_c), p.cable) - l_c[..., 2] * p.f_z + V_0


def dissipated(x: Array, p: Loop) -> Array:
    """v_HᵀB_Hv_H + v_RᵀB_Av_R in W, (...)."""
    return lost_power(list(np.moveaxis(x, -1, 0)), p)


def lost_power(x: Components, p: Loop) -> Scalar:
    """`dissipated` of components."""
    return p.b_H * (x[3] ** 2 + x[4] ** 2) + p.b_A * (x[9] ** 2 + x[10] ** 2 + x[11] ** 2)


def pull_up(x: Array, p: Loop) -> Array:
    """f_c·z in N, (...): the ground holds the hand down only while this stays below m_H g."""
    l_c = x[..., 6:9] - x[..., 0:3]
    length = norm(l_c)
    return cable.tension(length, 0.0 * length, p.cable) * l_c[..., 2] / (length + 1e-300)


def weight(p: Loop) -> Scalar:
    """m_H g in N."""
    return p.m_H * GRAVITY_MPS2


def runge_kutta(x: Array, p: Loop, inputs: Inputs, seconds: float, dt: float) -> tuple[Array, Array, Array]:
    """x, the energy supplied at both ports and the energy dissipated, at every step: (steps + 1, ..., 12), twice (...).

    The classic method of order 4 on all three together; inputs are continued from the right within a step.
    """
    now: list[Any] = [*np.moveaxis(x, -1, 0), np.zeros(x.shape[:-1]), np.zeros(x.shape[:-1])]

    def slope(y: list[Any], u: tuple[Components, Components]) -> list[Any]:
        u_R, u_H = u
        supplied = sum(u_R[i] * y[9 + i] + u_H[i] * y[3 + i] for i in range(3))
        return [*flow(y[:12], p, u_R, u_H), supplied, lost_power(y, p)]

    def ahead(k: list[Any], step: float) -> list[Any]:
        return [a + step * b for a, b in zip(now, k, strict=True)]

    rows = [now]
    for n in range(round(seconds / dt)):
        early, middle, late = (inputs((n + part) * dt) for part in (1e-9, 0.5, 1.0 - 1e-9))
        k1 = slope(now, early)
        k2 = slope(ahead(k1, dt / 2), middle)
        k3 = slope(ahead(k2, dt / 2), middle)
        k4 = slope(ahead(k3, dt), late)
        now = [y + dt / 6 * (a + 2 * b + 2 * c + d) for y, a, b, c, d in zip(now, k1, k2, k3, k4, strict=True)]
        rows.append(now)
    together = np.moveaxis(np.array(rows), 1, -1)
    return together[..., :12], together[..., 12], together[..., 13]
