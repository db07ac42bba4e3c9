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
from numpy.typing import NDArray

from services import cable
from services.parameters import Positive, parameters
from services.physics import Array, Scalar, at_least, choose, clamp, components, norm, scalar, vector

LONG_S = 1e3


class Sample(IntEnum):
    """What became of a measurement."""

    ACCEPTED = 0
    MISSING = 1  # no measurement in this frame: coasting
    JUMP = 2  # further from the prediction than it can be: coasting
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
    """Position, velocity, (..., 3); times in s, (...): since a measurement was accepted, how much of that without any
    measurement, and since the last restart."""

    p: Array
    v: Array
    unseen_s: Scalar
    hidden_s: Scalar
    settled_s: Scalar


class Output(NamedTuple):
    """Position in m, velocity in m/s, (..., 3); what became of the measurement; may the result be used, (...)."""

    p: Array
    v: Array
    sample: Scalar
    valid: Scalar


def start(shape: tuple[int, ...] = ()) -> State:
    """Nothing seen yet: the first measurement restarts the filter."""
    zero = np.zeros((*shape, 3))
    return State(zero, zero, scalar(np.full(shape, LONG_S)), scalar(np.zeros(shape)), scalar(np.zeros(shape)))


def step(
    state: State,
    z: Array,
    measured: Scalar,
    dt: Scalar,
    p: Filter,
    *,
    follows: Scalar = True,
    may_restart: Scalar = True,
) -> tuple[State, Output]:
    """One frame, `dt` s after the last; `z` (m, (..., 3)) counts only where `measured`.

    The gate widens while nothing is measured, `gate_m + gate_mps * time`: a hand may have moved. It does not while it
    keeps measurements out: what has jumped stays out until `lost_s`. Whoever knows more of a measurement may say that it
    does not follow from the last ones (`follows`), or that this is no place to begin anew (`may_restart`). Valid: accepted
    within `lost_s`, and `settle_s` have passed since a restart (a restart has no velocity yet).
    """
    unseen_s, v = state.unseen_s + dt, components(state.v)
    hidden_s = state.hidden_s + choose(measured, 0.0, dt)
    predicted = [x + dt * v_i for x, v_i in zip(components(state.p), v, strict=True)]
    r = [x - there for x, there in zip(components(z), predicted, strict=True)]
    near = (sum(d * d for d in r) ** 0.5 <= p.gate_m + p.gate_mps * (hidden_s + dt)) & follows
    lost = unseen_s > p.lost_s
    fresh = choose(may_restart, Sample.RESTART, Sample.JUMP)
    sample = choose(lost, fresh, choose(near, Sample.ACCEPTED, Sample.JUMP))
    sample = choose(measured, sample, Sample.MISSING)
    restart, accept = sample == Sample.RESTART, sample == Sample.ACCEPTED
    # After a gap the gain is that of the whole gap, so the filter forgets a stale velocity.
    alpha, beta_per_s = (choose(accept, gain, 0.0) for gain in _gains(unseen_s, p.tau_s))
    alpha, keep = choose(restart, 1.0, alpha), choose(restart, 0.0, 1.0)
    p_H = vector(*(there + alpha * d for there, d in zip(predicted, r, strict=True)))
    v_H = vector(*(keep * v_i + beta_per_s * d for v_i, d in zip(v, r, strict=True)))
    unseen_s = choose(restart | accept, 0.0, clamp(unseen_s, 0.0, LONG_S))
    hidden_s = choose(restart | accept, 0.0, clamp(hidden_s, 0.0, LONG_S))
    settled_s = choose(restart, 0.0, clamp(state.settled_s + dt, 0.0, LONG_S))
    valid = (unseen_s <= p.lost_s) & (settled_s >= p.settle_s)
    return State(p_H, v_H, unseen_s, hidden_s, settled_s), Output(p_H, v_H, sample, valid)


def _gains(dt: Scalar, tau_s: float) -> tuple[Scalar, Scalar]:
    """alpha and beta/dt (1/s) for a step of `dt` s."""
    theta = scalar(np.exp(-dt / tau_s))
    return 1.0 - theta**2, (1.0 - theta) ** 2 / at_least(dt, 1e-9)


def fallback(p_R: Array, f_c: Array, c: cable.Cable, f_min_N: float) -> tuple[Array, NDArray[np.bool_]]:
    """Hand from robot and cable force in m, (..., 3), and whether the force is large enough to say so, (...).

    Only a taut cable points at the hand; below `f_min_N` the direction of f̂_c is mostly noise and bias.
    """
    usable = norm(f_c) > f_min_N
    safe = np.where(usable[..., None], f_c, np.array([0.0, 0.0, 1.0]))
    return cable.hand(p_R, safe, c), usable
