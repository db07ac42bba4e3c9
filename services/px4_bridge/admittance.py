"""The admittance filter: it turns the cable's pull and the guiding force into a motion of the robot's reference.

| paper | here | unit | frame |
|---|---|---|---|
| p_R, v_R, u_R of the filter | State.p, State.v, State.a | m, m/s, m/s² | W |
| M_A, B_A | M_A_kg, b_A_Ns_per_m | kg, N s/m | |
| K_H = diag(k_H, k_H, 0) | k_H_N_per_m | N/m | |
| f_c (on the handle; the robot feels -f_c) | f_c | N | W |
| u_A = K_H sat(p_R^d - p_R) + f^d | Command, u_A | N | W |

Source: the paper's admittance `u_R = M_A⁻¹(-B_A v_R - f_c + u_A)` with these additions: the spring acts on the
filter's own reference (G5b) and is saturated (G9); a small K_z and the handle's weight hold the height while nobody
holds the handle (G1, G6); more damping while free or slack (G6, G7); a ceiling (G6). All of them keep the filter
passive at (-f_c, v).

Discretisation: force and spring centre are held over dt, then each axis is M p̈ + b ṗ + k p = const, solved in closed
form, so a step of dt equals two of dt/2. Two switches are judged once per step, at its start: a saturated spring is a
constant force for that step (first order in dt, only while saturated), and the ceiling is applied at its end.
Broadcasts over leading axes.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from services.parameters import Positive, parameters
from services.physics import Array, Components, Row, Scalar, at_least, choose, clamp, components, scalar, vector

LONG_S = 1e3
RATIO_MIN, RATIO_MAX = 0.9, 2.0


@parameters
class Admittance:
    """Virtual mass, dampings and springs of the filter."""

    M_A_kg: Positive
    b_A_Ns_per_m: Positive
    k_H_N_per_m: Positive
    k_z_N_per_m: Positive
    e_R_max_m: Positive
    b_free_Ns_per_m: Positive
    b_slack_Ns_per_m: Positive
    slack_keep_s: Positive


class State(NamedTuple):
    """Reference p, v, a = u_R, (..., 3), and the time since the cable was last slack in s, (...)."""

    p: Array
    v: Array
    a: Array
    taut_s: Scalar


class Command(NamedTuple):
    """What the filter is asked for; make it with `guide`, `wait`, `hold_height`, `ease` or `literal`."""

    p_d: Array  # centre of the springs in m, (..., 3)
    f_d: Array  # feed-forward force in N, (..., 3)
    scale: Scalar  # of everything horizontal in u_A, (...)
    k_z: float  # N/m
    k_xy: float  # N/m before the scale
    free: bool  # nobody holds the handle


def check(M_A_kg: float, m_R_kg: float) -> None:
    """Raise ValueError unless 0.9 <= M_A/m_R <= 2: below it the filter is delayed positive feedback (G5)."""
    if not RATIO_MIN <= M_A_kg / m_R_kg <= RATIO_MAX:
        raise ValueError(
            f"M_A_kg = {M_A_kg}: M_A/m_R = {M_A_kg / m_R_kg:.2f} with m_R_kg = {m_R_kg}, "
            f"must be between {RATIO_MIN} and {RATIO_MAX}"
        )


def engage(p_setpoint: Array) -> State:
    """The filter at rest at the last set-point sent (G9), (..., 3)."""
    zero = np.zeros_like(p_setpoint)
    return State(p_setpoint, zero, zero, scalar(np.full(p_setpoint.shape[:-1], LONG_S)))


def guide(p_R_d: Array, f_d: Array, scale: ArrayLike, p: Admittance) -> Command:
    """Phase 2, held: u_A = scale [K_H sat(p_R^d - p) + f_xy] + f_z z."""
    return _command(p_R_d, f_d, scale, k_z=0.0, k_xy=p.k_H_N_per_m, free=False)


def wait(p_anchor: Array, handle_weight_N: float, p: Admittance) -> Command:
    """Phase 1 (G1): stay at `p_anchor` with K_H and K_z and carry the hanging handle, until a hand takes it."""
    return _command(p_anchor, _up(p_anchor, handle_weight_N), 1.0, k_z=p.k_z_N_per_m, k_xy=p.k_H_N_per_m, free=True)


def hold_height(p_hold: Array, handle_weight_N: float, p: Admittance) -> Command:
    """Let go (G6): no horizontal force at all, height of `p_hold`, the hanging handle carried, more damping."""
    return _command(p_hold, _up(p_hold, handle_weight_N), 0.0, k_z=p.k_z_N_per_m, k_xy=p.k_H_N_per_m, free=True)


def ease(p_hold: Array, p: Admittance) -> Command:
    """Back off: no force but a soft spring to the height of `p_hold`; a walking person drags the robot along at b_A."""
    return _command(p_hold, np.zeros_like(p_hold), 0.0, k_z=p.k_z_N_per_m, k_xy=p.k_H_N_per_m, free=False)


def literal(u_A: Array) -> Command:
    """The paper's form, for comparison (G5b): u_A comes from the ground, spring on the measured robot included."""
    return _command(u_A, u_A, 1.0, k_z=0.0, k_xy=0.0, free=False)


def u_A(p_ref: Array, c: Command, p: Admittance) -> Array:
    """u_A at reference `p_ref` in N, (..., 3)."""
    return vector(*_u_A(components(p_ref), c, p)[0])


def damping(state: State, c: Command, p: Admittance) -> Row:
    """B_A by axes in N s/m, as it was in the step that led to `state`."""
    return _damping(state.taut_s, c, p)


def step(
    state: State, f_c: Array, c: Command, slack: Scalar, dt: Scalar, z_max_m: float, p: Admittance
) -> tuple[State, Array]:
    """Advance the filter by `dt` (s) under the cable force `f_c`; returns it and u_A at the new reference, (..., 3).

    `slack`: the cable is slack by motion capture; then, and for `slack_keep_s` after, z is damped more (G7).
    `z_max_m`: the ceiling, hand plane + l̄ + 0.1 m; a reference that starts above it may sink but not rise.
    """
    taut_s = choose(slack, 0.0, clamp(state.taut_s + dt, 0.0, LONG_S))
    b, pull, before = _damping(taut_s, c, p), components(f_c), components(state.p)
    u, k = _u_A(before, c, p)
    xy, z = (_response(0.5 * b[i] / p.M_A_kg, k[i] / p.M_A_kg, dt) for i in (0, 2))
    position, velocity = list[Scalar](), list[Scalar]()
    for (moved, gained, kept), x, v, u_i, f in zip((xy, xy, z), before, components(state.v), u, pull, strict=True):
        a_0 = (u_i - f) / p.M_A_kg
        position.append(x + gained * v + moved * a_0)
        velocity.append(kept * v + gained * a_0)
    position[2], velocity[2] = _under_ceiling(position[2], velocity[2], at_least(before[2], z_max_m))
    u, _ = _u_A(position, c, p)
    a = ((u_i - f - b_i * v) / p.M_A_kg for u_i, f, b_i, v in zip(u, pull, b, velocity, strict=True))
    return State(vector(*position), vector(*velocity), vector(*a), taut_s), vector(*u)


def _response(a: Scalar, w2: Scalar, dt: Scalar) -> Row:
    """δ̈ + 2a δ̇ + w² δ = u from δ = 0: δ = moved u + gained v, δ̇ = gained u + kept v; exact, every damping ratio."""
    cosine, sine = _decaying(a * dt, (a * a - w2) * dt * dt)
    gained = sine * dt
    kept = cosine - a * gained
    stiff = w2 * dt * dt > 1e-8  # below, both forms agree to 1e-8 and the first loses digits
    moved = choose(stiff, 1.0 - cosine - a * gained, dt - gained) / choose(stiff, w2, 2.0 * a)
    return moved, gained, kept


def _decaying(decay: Scalar, z: Scalar) -> tuple[Scalar, Scalar]:
    """cosh √z and sinh √z/√z, which are cos √-z and sin √-z/√-z for z < 0; both times exp(-decay)."""
    if type(z) is float:
        r, fade = max(abs(z), 1e-16) ** 0.5, math.exp(-decay)
        return (fade * math.cosh(r), fade * math.sinh(r) / r) if z > 0 else (fade * math.cos(r), fade * math.sin(r) / r)
    r, fade, grows = np.sqrt(np.maximum(np.abs(z), 1e-16)), np.exp(-decay), z > 0
    return fade * choose(grows, np.cosh(r), np.cos(r)), fade * choose(grows, np.sinh(r), np.sin(r)) / r


def _u_A(p_ref: Components, c: Command, p: Admittance) -> tuple[Row, Row]:
    """u_A at `p_ref` in N and the stiffness behind it in N/m (0 where the spring is saturated), by axes."""
    (x, y, z), (x_d, y_d, z_d), (f_x, f_y, f_z) = p_ref, components(c.p_d), components(c.f_d)
    e_x, e_y, e_z = x_d - x, y_d - y, z_d - z
    along, k_xy = _spring((e_x * e_x + e_y * e_y) ** 0.5, c.scale * c.k_xy, p)
    up, k_z = _spring(abs(e_z), c.k_z, p)
    return (along * e_x + c.scale * f_x, along * e_y + c.scale * f_y, up * e_z + f_z), (k_xy, k_xy, k_z)


def _spring(length: Scalar, k: Scalar, p: Admittance) -> tuple[Scalar, Scalar]:
    """Force per length of the saturated spring and its stiffness, both in N/m."""
    over = at_least(length / p.e_R_max_m, 1.0)
    return k / over, choose(over > 1.0, 0.0, k)


def _damping(taut_s: Scalar, c: Command, p: Admittance) -> Row:
    """b per axis in N s/m."""
    b = p.b_free_Ns_per_m if c.free else p.b_A_Ns_per_m
    return b, b, choose(taut_s < p.slack_keep_s, max(b, p.b_slack_Ns_per_m), b)


def _under_ceiling(z: Scalar, v: Scalar, z_max: Scalar) -> tuple[Scalar, Scalar]:
    """Stop a rise at `z_max`; what is taken is kinetic energy, so the filter stays passive."""
    risen = z > z_max
    return choose(risen, z_max, z), choose(risen, clamp(v, -np.inf, 0.0), v)


def _up(like: Array, force_N: float) -> Array:
    force = np.zeros_like(like)
    force[..., 2] = force_N
    return force


def _command(p_d: Array, f_d: Array, scale: ArrayLike, *, k_z: float, k_xy: float, free: bool) -> Command:
    return Command(p_d, f_d, scalar(np.asarray(scale, dtype=np.float64)), k_z, k_xy, free)
