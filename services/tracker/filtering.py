"""Hand position and velocity from motion capture: a constant-velocity filter with a gate, and a stand-in.

| paper | here | unit | frame |
|---|---|---|---|
| p_H, v_H | State.p, State.v | m, m/s | W |
| p_H = p_R - f_c (1/k_c + l̄/‖f_c‖), last remark | fallback | m | W |

The filter is the alpha-beta filter with both poles at θ = exp(-dt/τ) (critically damped; alpha = 1 - θ², beta = (1 -
θ)²), so one parameter τ and any dt. Lag: none in position at constant velocity; at constant acceleration a the
position is behind by a τ² and the velocity by 2 τ a (for dt << τ). Broadcasts over leading axes.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from services import cable
from services.parameters import Positive, parameters
from services.physics import Array, norm

LONG_S = 1e3


class Sample(IntEnum):
    """What became of a measurement."""

    ACCEPTED = 0
    MISSING = 1  # no measurement in this frame: coasting
    JUMP = 2  # further from the prediction than a hand can be: coasting
    RESTART = 3  # nothing was accepted for `lost_s`: begin anew from this one


@parameters
class Filter:
    """Time constant, gate and patience."""

    tau_s: Positive
    gate_m: Positive
    gate_mps: Positive
    lost_s: Positive
    settle_s: Positive


class State(NamedTuple):
    """Position, velocity, (..., 3); time since a measurement was accepted and since the last restart in s, (...)."""

    p: Array
    v: Array
    unseen_s: Array
    settled_s: Array


class Output(NamedTuple):
    """Position in m, velocity in m/s, (..., 3); what became of the measurement; may the result be used, (...)."""

    p: Array
    v: Array
    sample: NDArray[np.int64]
    valid: NDArray[np.bool_]


def start(shape: tuple[int, ...] = ()) -> State:
    """Nothing seen yet: the first measurement restarts the filter."""
    zero = np.zeros((*shape, 3))
    return State(zero, zero, np.full(shape, LONG_S), np.zeros(shape))


def step(state: State, z: Array, measured: ArrayLike, dt: ArrayLike, p: Filter) -> tuple[State, Output]:
    """One frame, `dt` s after the last; `z` (m, (..., 3)) counts only where `measured`.

    The gate widens with the time since the last accepted measurement, `gate_m + gate_mps * time`: a hand may have
    moved. Valid: accepted within `lost_s`, and `settle_s` have passed since a restart (a restart has no velocity
    yet).
    """
    dt = np.asarray(dt, dtype=np.float64)
    measured, unseen_s = np.asarray(measured), state.unseen_s + dt
    predicted = state.p + state.v * dt[..., None]
    r = z - predicted
    restart = measured & (unseen_s > p.lost_s)
    accept = measured & ~restart & (norm(r) <= p.gate_m + p.gate_mps * unseen_s)
    # After a gap the gain is that of the whole gap, so the filter forgets a stale velocity.
    alpha, beta_per_s = _gains(unseen_s, p.tau_s)
    used = np.where(accept[..., None], r, 0.0)
    p_H = np.where(restart[..., None], z, predicted + alpha[..., None] * used)
    v_H = np.where(restart[..., None], 0.0, state.v + beta_per_s[..., None] * used)
    unseen_s = np.where(accept | restart, 0.0, np.minimum(unseen_s, LONG_S))
    settled_s = np.where(restart, 0.0, np.minimum(state.settled_s + dt, LONG_S))
    sample = np.select(
        [restart, accept, ~measured], [Sample.RESTART, Sample.ACCEPTED, Sample.MISSING], Sample.JUMP
    ).astype(np.int64)
    valid = (unseen_s <= p.lost_s) & (settled_s >= p.settle_s)
    return State(p_H, v_H, unseen_s, settled_s), Output(p_H, v_H, sample, valid)


def _gains(dt: Array, tau_s: float) -> tuple[Array, Array]:
    """alpha and beta/dt (1/s) for a step of `dt` s."""
    theta = np.exp(-dt / tau_s)
    return 1.0 - theta**2, (1.0 - theta) ** 2 / np.maximum(dt, 1e-9)


def fallback(p_R: Array, f_c: Array, c: cable.Cable, f_min_N: float) -> tuple[Array, NDArray[np.bool_]]:
    """Hand from robot and cable force in m, (..., 3), and whether the force is large enough to say so, (...).

    Only a taut cable points at the hand; below `f_min_N` the direction of f̂_c is mostly noise and bias.
    """
    usable = norm(f_c) > f_min_N
    safe = np.where(usable[..., None], f_c, np.array([0.0, 0.0, 1.0]))
    return cable.hand(p_R, safe, c), usable
