"""Geometry of the cascade's inner loops: how far the attitude is off, and which motors turn it.

| PX4 | here | unit | frame |
|---|---|---|---|
| body z of the attitude set-point | thrust_direction_W | - | W |
| attitude error, twice the vector part of the error quaternion | attitude_error | rad | B |
| torque set-point, normalised | torque | fraction of the motors' authority | B |

Forward-left-up body, z-up world; motors as in quadrotor.py. Everything broadcasts over leading axes.
"""

import numpy as np
from numpy.typing import NDArray

from services.physics import rotation_matrix
from services.simulator.quadrotor import FORWARD, LEFT, SPIN

Array = NDArray[np.float64]

_TILTING = np.stack((LEFT, -FORWARD, np.zeros(4)))
_TWISTING = np.stack((np.zeros(4), np.zeros(4), SPIN))


def attitude_error(q_WB_wxyz: Array, thrust_direction_W: Array, yaw_rad: Array, yaw_weight: float) -> Array:
    """Tilt first, heading with a lower weight, as PX4 does; (..., 3) rad in the body frame.

    The desired attitude is reached from the present one by the shortest tilt (w, x, y, 0), then a twist about the thrust axis.
    The twist is shortened by `yaw_weight`, and twice the vector part of tilt ⊗ twist is the error.
    """
    R_WB = rotation_matrix(q_WB_wxyz)
    z = thrust_direction_W
    sin, cos = np.sin(yaw_rad), np.cos(yaw_rad)
    x_W = np.stack((cos * z[..., 2], sin * z[..., 2], -(cos * z[..., 0] + sin * z[..., 1])), axis=-1)
    z_B = (z[..., None, :] @ R_WB)[..., 0, :]
    x_B = (x_W[..., None, :] @ R_WB)[..., 0, :]
    w = np.sqrt(np.maximum(0.5 * (1.0 + z_B[..., 2]), 1e-9))
    x, y = -0.5 * z_B[..., 1] / w, 0.5 * z_B[..., 0] / w
    twist = np.arctan2(
        2 * x * y * x_B[..., 0] + (1 - 2 * x * x) * x_B[..., 1] + 2 * w * x * x_B[..., 2],
        (1 - 2 * y * y) * x_B[..., 0] + 2 * x * y * x_B[..., 1] - 2 * w * y * x_B[..., 2],
    )
    c, s = np.cos(0.5 * yaw_weight * twist), np.sin(0.5 * yaw_weight * twist)
    return 2.0 * np.stack((x * c + y * s, y * c - x * s, w * s), axis=-1)


def mix(thrust: Array, torque: Array) -> Array:
    """Motor commands (..., 4) in 0..1 from collective thrust (...,) and torque (..., 3).

    Without air mode: to keep roll and pitch the collective gives way upwards, never downwards; yaw takes what is left.
    """
    motors = thrust[..., None] + torque @ _TILTING
    motors = motors - np.maximum(motors.max(-1, keepdims=True) - 1.0, 0.0)
    return np.minimum(np.maximum(motors + torque @ _TWISTING, 0.0), 1.0)
