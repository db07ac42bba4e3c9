"""What sensors make of the truth: noise and bias of an inertial unit, a barometer and motion capture.

| symbol | here | unit | frame |
|---|---|---|---|
| specific force, body rate | specific_force_B, omega_B | m/s², rad/s | B |
| noise density | accel_density, gyro_density | m/s²/√Hz, rad/s/√Hz | B |
| pose | p_W, q_WB_wxyz | m, - | W |

Laws have no randomness: each function takes an array of standard normal numbers, drawn by the caller from a seeded generator.
Densities are of the output after the flight controller's filters, as over MAVLink, not of the raw chip. Everything broadcasts.
"""

import math

import numpy as np
from numpy.typing import NDArray

from services.parameters import NonNegative, parameters
from services.simulator.quadrotor import turn

Array = NDArray[np.float64]

BAROMETER_SIGMA_M = 0.1
"""Of a common chip at 50 Hz. One that repeats itself counts as broken with PX4, and a vehicle on the ground would have none."""


@parameters
class Imu:
    """White noise and constant bias of accelerometer and gyroscope."""

    accel_density_mps2_per_rtHz: NonNegative
    gyro_density_rad_s_per_rtHz: NonNegative
    accel_bias_mps2: tuple[float, float, float]
    gyro_bias_rad_s: tuple[float, float, float]


@parameters
class Mocap:
    """Standard deviation of one motion capture pose, for each axis."""

    position_sigma_m: NonNegative
    attitude_sigma_rad: NonNegative


def accelerometer(specific_force_B: Array, normal: Array, dt: float, p: Imu) -> Array:
    """A reading in m/s², (..., 3), of a sensor that gives one sample every `dt`; `normal` is (..., 3)."""
    return specific_force_B + p.accel_bias_mps2 + (p.accel_density_mps2_per_rtHz / math.sqrt(dt)) * normal


def gyroscope(omega_B: Array, normal: Array, dt: float, p: Imu) -> Array:
    """A reading in rad/s, (..., 3), of a sensor that gives one sample every `dt`; `normal` is (..., 3)."""
    return omega_B + p.gyro_bias_rad_s + (p.gyro_density_rad_s_per_rtHz / math.sqrt(dt)) * normal


def barometer(height_m: float, normal: float) -> float:
    """A reading in m; `normal` is one number."""
    return height_m + BAROMETER_SIGMA_M * normal


def mocap(p_W: Array, q_WB_wxyz: Array, normal: Array, p: Mocap) -> tuple[Array, Array]:
    """A measured pose, (..., 3) and (..., 4), from a true one; `normal` is (..., 6): position, then rotation vector."""
    turned = turn(q_WB_wxyz, p.attitude_sigma_rad * normal[..., 3:], 1.0)
    return p_W + p.position_sigma_m * normal[..., :3], turned
