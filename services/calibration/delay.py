"""How much older a motion-capture pose is than its stamp says, by the gyroscope: PX4's EKF2_EV_DELAY.

| symbol | here | unit | frame |
|---|---|---|---|
| attitude by motion capture, its stamps | q_WB_wxyz, pose_t_s | | |
| body rate by the gyroscope, its stamps | omega_B, imu_t_s | rad/s, s | B |

From a pose to one 0.1 s later the vehicle turned by what the gyroscope's rates add up to between the moments that the poses show:
the stamps less the delay. The delay is the one that leaves least of the difference, with a constant bias of the gyroscope
in it. A rate is the mean over the time since the sample before, as in PX4's HIGHRES_IMU: taken as that of its moment it
would make the delay half a sample too short. Both clocks are the host's. The frames of marker body and inertial unit must
be the same: where they are not, much is left.
"""

from typing import NamedTuple

import numpy as np

from services.calibration.fit import Unfit, lowest
from services.physics import Array, components, conjugate, quaternion_product

DELAYS_S = np.linspace(-0.05, 0.25, 151)
SPAN_S, LONGEST_SPAN_S = 0.1, 0.2
"""A pose's own noise makes a rate of its own, the smaller the longer the time between two poses."""
SHORTEST_S = 5.0
RATE_MIN_RAD_S = 0.05


class DelayFit(NamedTuple):
    """`delay_s` with its standard error; rms of an axis of the rates that were left, and of the rates, rad/s."""

    delay_s: float
    sigma_s: float
    left_rad_s: float
    rate_rad_s: float
    condition: float
    """Largest over smallest rms rate of the three axes: what it rests on."""
    seconds: float


def delay(pose_t_s: Array, q_WB_wxyz: Array, imu_t_s: Array, omega_B: Array) -> DelayFit:
    """From stamps (N,) with attitudes (N, 4) and stamps (M,) with rates (M, 3), both in order. Raises Unfit."""
    apart = max(round(SPAN_S / float(np.median(np.diff(pose_t_s)))), 1) if len(pose_t_s) > 1 else 1
    begins, ends = pose_t_s[:-apart], pose_t_s[apart:]
    spans = ends - begins
    use = (spans > 0.5 * SPAN_S) & (spans < LONGEST_SPAN_S)
    use &= (begins > float(imu_t_s[0]) + DELAYS_S[-1]) & (ends < float(imu_t_s[-1]) + DELAYS_S[0])
    begins, ends, spans = begins[use], ends[use], spans[use, None]
    seconds = float(np.sum(spans)) / apart
    if seconds < SHORTEST_S:
        raise Unfit(f"{seconds:.1f} s of poses with the gyroscope beside them, at least {SHORTEST_S:g} s are needed")
    seen = _rotation(q_WB_wxyz[:-apart][use], q_WB_wxyz[apart:][use]) / spans
    angle = _integral(imu_t_s, omega_B)

    def left(delay_s: float) -> Array:
        turned = _at(imu_t_s, angle, ends - delay_s) - _at(imu_t_s, angle, begins - delay_s)
        difference = seen - turned / spans
        return difference - difference.mean(axis=0)

    found = lowest(lambda d: float(np.mean(left(d) ** 2)), DELAYS_S)
    rate = seen - seen.mean(axis=0)
    rms: Array = np.sqrt(np.mean(rate**2, axis=0))
    if float(np.max(rms)) < RATE_MIN_RAD_S:
        raise Unfit(
            f"it turned at {np.max(rms):.3f} rad/s (rms), at least {RATE_MIN_RAD_S:g} are needed: turn it by hand"
        )
    step = float(DELAYS_S[1] - DELAYS_S[0])
    slope: Array = (left(found + step) - left(found - step)) / (2.0 * step)
    rest = left(found)
    sigma = _rms(rest) / _rms(slope) * float(np.sqrt(apart / rest.size))  # spans that overlap say the same
    return DelayFit(found, sigma, _rms(rest), _rms(rate), float(np.max(rms) / max(float(np.min(rms)), 1e-9)), seconds)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _rotation(first: Array, then: Array) -> Array:
    """From each attitude to the other as a rotation vector in the body, (N, 3) rad."""
    step = quaternion_product(conjugate(first), then)
    w, x, y, z = components(np.where(step[:, :1] < 0.0, -step, step))
    axis = np.stack((x, y, z), axis=-1)
    half_sine = np.linalg.norm(axis, axis=-1)
    factor = 2.0 * np.arctan2(half_sine, w) / np.maximum(half_sine, 1e-12)
    return np.where(half_sine[:, None] < 1e-9, 2.0 * axis, factor[:, None] * axis)


def _integral(t_s: Array, rate: Array) -> Array:
    """Of the rates from the first sample on, (M, 3)."""
    pieces = rate[1:] * np.diff(t_s)[:, None]
    return np.concatenate((np.zeros((1, rate.shape[1])), np.cumsum(pieces, axis=0)))


def _at(t_s: Array, values: Array, when: Array) -> Array:
    each: list[Array] = [np.interp(when, t_s, column) for column in values.T]
    return np.stack(each, axis=-1)
