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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from services.parameters import Positive, parameters
from services.physics import GRAVITY_MPS2, rotate

Array = NDArray[np.float64]

_GRAVITY = np.array([0.0, 0.0, GRAVITY_MPS2])
_LONGEST_GAP_S = 0.1  # beyond it the gains of a correction do not grow


@parameters
class Estimator:
    """Correction bandwidth, innovation gate, and patience."""

    bandwidth_rad_s: Positive
    gate_m: Positive
    rejection_s: Positive
    dead_reckoning_s: Positive


class EstimatorState(NamedTuple):
    """p_W, v_W (3,); seconds since a pose was last accepted (infinite before the first); resets counted."""

    p_W: Array
    v_W: Array
    since_accepted_s: float
    resets: int


def initial(p_W: Array) -> EstimatorState:
    """At rest at `p_W`, which is not trusted before the first pose."""
    return EstimatorState(p_W.astype(float), np.zeros(3), math.inf, 0)


def propagate(
    state: EstimatorState, specific_force_B: Array, q_WB_wxyz: Array, dt: float, *, resting: bool
) -> EstimatorState:
    """One inertial step; a vehicle that rests on the ground is known to stand still."""
    since = state.since_accepted_s + dt
    if resting:
        return state._replace(v_W=np.zeros(3), since_accepted_s=since)
    a_W = rotate(q_WB_wxyz, specific_force_B) - _GRAVITY
    v_W = state.v_W + dt * a_W
    return state._replace(p_W=state.p_W + dt * (v_W - (0.5 * dt) * a_W), v_W=v_W, since_accepted_s=since)


def correct(state: EstimatorState, z_W: Array, p: Estimator) -> EstimatorState:
    """Take a pose, refuse it, or give in to it."""
    innovation = z_W - state.p_W
    if float(innovation @ innovation) > p.gate_m**2 or math.isinf(state.since_accepted_s):
        if state.since_accepted_s < p.rejection_s:
            return state
        return EstimatorState(z_W.astype(float), state.v_W, 0.0, state.resets + 1)
    dt = min(max(state.since_accepted_s, 1e-3), _LONGEST_GAP_S)
    decay = math.exp(-p.bandwidth_rad_s * dt)
    p_W = state.p_W + (1.0 - decay * decay) * innovation
    return EstimatorState(p_W, state.v_W + ((1.0 - decay) ** 2 / dt) * innovation, 0.0, state.resets)


def is_valid(state: EstimatorState, p: Estimator) -> bool:
    """Whether the position may be flown by."""
    return state.since_accepted_s < p.dead_reckoning_s
