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

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from services.parameters import Positive, parameters
from services.physics import Array

Flags = NDArray[np.bool_]
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
    taut_s: Array


class Command(NamedTuple):
    """What the filter is asked for; make it with `guide`, `wait`, `hold_height`, `ease` or `literal`."""

    p_d: Array  # centre of the springs in m, (..., 3)
    f_d: Array  # feed-forward force in N, (..., 3)
    scale: Array  # of everything horizontal in u_A, (...)
    k_z: Array  # N/m, (...)
    k_xy: Array  # N/m before the scale, (...)
    free: Flags  # nobody holds the handle, (...)


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
    return State(p_setpoint, zero, zero, np.full(p_setpoint.shape[:-1], LONG_S))


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
    return _spring(p_ref, c, p)[0] + _feed_forward(c)


def step(
    state: State, f_c: Array, c: Command, slack: ArrayLike, dt: float | Array, z_max_m: float, p: Admittance
) -> tuple[State, Array]:
    """Advance the filter by `dt` (s) under the cable force `f_c`; returns it and u_A at the new reference, (..., 3).

    `slack`: the cable is slack by motion capture; then, and for `slack_keep_s` after, z is damped more (G7).
    `z_max_m`: the ceiling, hand plane + l̄ + 0.1 m; a reference that starts above it may sink but not rise.
    """
    taut_s = np.where(slack, 0.0, np.minimum(state.taut_s + dt, LONG_S))
    b = _damping(taut_s, c, p)
    spring, k = _spring(state.p, c, p)
    constant = _feed_forward(c) - f_c
    a_0 = (constant + spring) / p.M_A_kg
    moved, gained, kept = _response(0.5 * b / p.M_A_kg, k / p.M_A_kg, np.asarray(dt)[..., None])
    position = state.p + gained * state.v + moved * a_0
    velocity = kept * state.v + gained * a_0
    position, velocity = _under_ceiling(position, velocity, np.maximum(z_max_m, state.p[..., 2]))
    u = u_A(position, c, p)
    return State(position, velocity, (u - f_c - b * velocity) / p.M_A_kg, taut_s), u


def _response(a: Array, w2: Array, dt: Array) -> tuple[Array, Array, Array]:
    """δ̈ + 2a δ̇ + w² δ = u from δ = 0: δ = gained v + moved u, δ̇ = kept v + gained u; exact, every damping
    ratio."""
    z = (a * a - w2) * dt * dt
    r = np.sqrt(np.maximum(np.abs(z), 1e-16))
    over = z > 0.0
    decay = np.exp(-a * dt)
    C = decay * np.where(over, np.cosh(r), np.cos(r))
    gained = decay * dt * np.where(over, np.sinh(r), np.sin(r)) / r
    stiff = w2 * dt * dt > 1e-8  # below, both forms agree to 1e-8 and the first loses digits
    rest = (1.0 - C - a * gained) / np.where(stiff, w2, 1.0)
    return np.where(stiff, rest, (dt - gained) / (2.0 * a)), gained, C - a * gained


def _spring(p_ref: Array, c: Command, p: Admittance) -> tuple[Array, Array]:
    """Force of the saturated spring in N and its stiffness in N/m (0 where saturated), both (..., 3)."""
    e = c.p_d - p_ref
    length = np.stack((h := np.hypot(e[..., 0], e[..., 1]), h, np.abs(e[..., 2])), axis=-1)
    k_xy = c.scale * c.k_xy
    k = np.stack((k_xy, k_xy, c.k_z), axis=-1)
    within = length <= p.e_R_max_m
    return k * e * np.where(within, 1.0, p.e_R_max_m / np.maximum(length, 1e-12)), np.where(within, k, 0.0)


def _feed_forward(c: Command) -> Array:
    return c.f_d * np.stack((c.scale, c.scale, np.ones_like(c.scale)), axis=-1)


def _damping(taut_s: Array, c: Command, p: Admittance) -> Array:
    """b per axis in N s/m, (..., 3)."""
    b = np.where(c.free, p.b_free_Ns_per_m, p.b_A_Ns_per_m)
    b_z = np.where(taut_s < p.slack_keep_s, np.maximum(b, p.b_slack_Ns_per_m), b)
    return np.stack(np.broadcast_arrays(b, b, b_z), axis=-1)


def _under_ceiling(position: Array, velocity: Array, z_max: Array) -> tuple[Array, Array]:
    """Stop a rise at `z_max` (...); what is taken is kinetic energy, so the filter stays passive."""
    if np.any(position[..., 2] > z_max):
        position, velocity = position.copy(), velocity.copy()
        velocity[..., 2] = np.where(position[..., 2] > z_max, np.minimum(velocity[..., 2], 0.0), velocity[..., 2])
        position[..., 2] = np.minimum(position[..., 2], z_max)
    return position, velocity


def _up(like: Array, force_N: float) -> Array:
    force = np.zeros_like(like)
    force[..., 2] = force_N
    return force


def _command(p_d: Array, f_d: Array, scale: ArrayLike, *, k_z: float, k_xy: float, free: bool) -> Command:
    batch = p_d.shape[:-1]
    return Command(
        p_d,
        f_d,
        np.broadcast_to(np.asarray(scale, dtype=np.float64), batch),
        np.full(batch, k_z),
        np.full(batch, k_xy),
        np.full(batch, free),
    )
