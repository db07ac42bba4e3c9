"""The stand-in for PX4's EKF2 flying on motion capture alone: where the vehicle believes it is.

| symbol | here | unit | frame |
|---|---|---|---|
| estimated position, velocity | p_W, v_W | m, m/s | W |
| accelerometer | specific_force_B | m/s² | B |
| motion-capture position | z_W | m | W |
| bandwidth of the correction | bandwidth_rad_s | rad/s | |

Inertial propagation with corrections by each pose (a critically damped alpha-beta filter), so that the lag behind
late poses, the drift without them and the rejection of jumps are real. Attitude is not estimated: it comes from
outside, the truth plus noise. A pose farther than `gate_m` from the estimate is refused; when nothing was accepted
for `rejection_s` the estimate is reset to it and the vehicle chases the jump. Without any pose the position counts
for `dead_reckoning_s`.
"""

import math
from bisect import bisect_left
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from services.parameters import Positive, parameters
from services.physics import GRAVITY_MPS2, rotate

Array = NDArray[np.float64]

_GRAVITY = np.array([0.0, 0.0, GRAVITY_MPS2])
_KEEP = 250  # moments: a second of PX4's inertial stream, and PX4 remembers no longer either
_LONGEST_GAP_S = 0.1  # beyond it the gains of a correction do not grow


@parameters
class Estimator:
    """Correction bandwidth, innovation gate, and patience."""

    bandwidth_rad_s: Positive
    gate_m: Positive
    rejection_s: Positive
    dead_reckoning_s: Positive
    delay_max_s: Positive
    """PX4's EKF2_DELAY_MAX."""


class Moment(NamedTuple):
    """P_W, V_W (3,) at `t_s`."""

    t_s: float
    P_W: Array
    V_W: Array


class EstimatorState(NamedTuple):
    """p_W, v_W (3,); seconds since a pose was last accepted (infinite before the first); resets counted; moments kept."""

    p_W: Array
    v_W: Array
    since_accepted_s: float
    resets: int
    past: tuple[Moment, ...] = (Moment(0.0, np.zeros(3), np.zeros(3)),)
    """Oldest first; the last is now."""


def initial(p_W: Array) -> EstimatorState:
    """At rest at `p_W`, which is not trusted before the first pose."""
    return EstimatorState(p_W.astype(float), np.zeros(3), math.inf, 0)


def propagate(
    state: EstimatorState, specific_force_B: Array, q_WB_wxyz: Array, dt: float, *, resting: bool
) -> EstimatorState:
    """One inertial step; a vehicle that rests on the ground is known to stand still."""
    since, (t_s, P_W, V_W) = state.since_accepted_s + dt, state.past[-1]
    if resting:
        past = (*state.past[-_KEEP:], Moment(t_s + dt, P_W, V_W))
        return state._replace(v_W=np.zeros(3), since_accepted_s=since, past=past)
    a_W = rotate(q_WB_wxyz, specific_force_B) - _GRAVITY
    dv, half = dt * a_W, (0.5 * dt * dt) * a_W
    past = (*state.past[-_KEEP:], Moment(t_s + dt, P_W + dt * V_W + half, V_W + dv))
    return EstimatorState(state.p_W + dt * state.v_W + half, state.v_W + dv, since, state.resets, past)


def correct(state: EstimatorState, z_W: Array, p: Estimator, age_s: float = 0.0) -> EstimatorState:
    """Take a pose that was taken `age_s` ago, refuse it, or give in to it."""
    then, now = _moment(state.past, age_s), state.past[-1]
    if age_s > p.delay_max_s:
        return state
    drift_W = (state.v_W - now.V_W) * (now.t_s - then.t_s)
    innovation = z_W - (state.p_W - (now.P_W - then.P_W) - drift_W)
    if float(innovation @ innovation) > p.gate_m**2 or math.isinf(state.since_accepted_s):
        if state.since_accepted_s < p.rejection_s:
            return state
        return state._replace(p_W=state.p_W + innovation, since_accepted_s=0.0, resets=state.resets + 1)
    dt = min(max(state.since_accepted_s, 1e-3), _LONGEST_GAP_S)
    decay = math.exp(-p.bandwidth_rad_s * dt)
    dp_W, dv_W = (1.0 - decay * decay) * innovation, ((1.0 - decay) ** 2 / dt) * innovation
    moved_W = dp_W + dv_W * (now.t_s - then.t_s)
    return state._replace(p_W=state.p_W + moved_W, v_W=state.v_W + dv_W, since_accepted_s=0.0)


def _moment(past: tuple[Moment, ...], age_s: float) -> Moment:
    """The one nearest to `age_s` ago."""
    then_s = past[-1].t_s - age_s
    n = bisect_left(past, then_s, key=lambda moment: moment.t_s)
    return min(past[max(n - 1, 0) : n + 1], key=lambda moment: abs(moment.t_s - then_s))


def is_valid(state: EstimatorState, p: Estimator) -> bool:
    """Whether the position may be flown by."""
    return state.since_accepted_s < p.dead_reckoning_s
