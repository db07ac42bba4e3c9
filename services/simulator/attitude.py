"""Geometry of the cascade: limits of speed and tilt, how far the attitude is off, and which motors turn it.

| PX4 | here | unit | frame |
|---|---|---|---|
| velocity set-point | first, total | m/s | W |
| body z of the attitude set-point | thrust_direction_W | - | W |
| attitude error, twice the vector part of the error quaternion | attitude_error | rad | B |
| torque set-point, normalised | torque | fraction of the motors' authority | B |

Forward-left-up body, z-up world; motors as in quadrotor.py. Everything broadcasts over leading axes.
"""

import math

from services.physics import (
    Array,
    Components,
    Scalar,
    angle,
    anywhere,
    at_least,
    choose,
    clamp,
    components,
    cos_sin,
    rotation_rows,
    scalar,
    vector,
)
from services.simulator.quadrotor import DIAGONAL, FORWARD, LEFT, SPIN

_MOTORS = tuple(zip(FORWARD.tolist(), LEFT.tolist(), SPIN.tolist(), strict=True))


def limit_xy(first: Components, total: Components, limit: float) -> Components:
    """`total` cut to `limit` in the plane so that its part `first` is kept before the rest; x and y."""
    rest_x, rest_y = total[0] - first[0], total[1] - first[1]
    size = (first[0] * first[0] + first[1] * first[1]) ** 0.5
    kept = limit / at_least(size, limit)
    x, y = first[0] * kept, first[1] * kept
    a = at_least(rest_x * rest_x + rest_y * rest_y, 1e-12)
    b = x * rest_x + y * rest_y
    c = x * x + y * y - limit**2
    share = clamp((at_least(b * b - a * c, 0.0) ** 0.5 - b) / a, -math.inf, 1.0)
    return x + rest_x * share, y + rest_y * share


def limit_tilt(x: Scalar, y: Scalar, z: Scalar, cos_max: float) -> Components:
    """A unit vector with its z kept above `cos_max`; what points straight down leans forward, as in PX4."""
    leans = z < cos_max
    if not anywhere(leans):
        return x, y, z
    forward = x + 1e-12
    flat = (forward * forward + y * y) ** 0.5 / math.sqrt(1.0 - cos_max**2)
    return choose(leans, forward / flat, x), choose(leans, y / flat, y), choose(leans, cos_max, z)


def attitude_error(q_WB_wxyz: Array, thrust_direction_W: Array, yaw_rad: Scalar, yaw_weight: float) -> Array:
    """Tilt first, heading with a lower weight, as PX4 does; (..., 3) rad in the body frame.

    The desired attitude is reached from the present one by the shortest tilt (w, x, y, 0), then a twist about the thrust axis.
    The twist is shortened by `yaw_weight`, and twice the vector part of tilt ⊗ twist is the error.
    """
    (z_1, z_2, z_3), (cos, sin) = components(thrust_direction_W), cos_sin(scalar(yaw_rad))
    x_1, x_2, x_3 = cos * z_3, sin * z_3, -(cos * z_1 + sin * z_2)
    columns = list(zip(*rotation_rows(components(q_WB_wxyz)), strict=True))
    z_B = [z_1 * a + z_2 * b + z_3 * c for a, b, c in columns]
    x_B = [x_1 * a + x_2 * b + x_3 * c for a, b, c in columns]
    w = at_least(0.5 * (1.0 + z_B[2]), 1e-9) ** 0.5
    x, y = -0.5 * z_B[1] / w, 0.5 * z_B[0] / w
    twist = angle(
        2 * x * y * x_B[0] + (1 - 2 * x * x) * x_B[1] + 2 * w * x * x_B[2],
        (1 - 2 * y * y) * x_B[0] + 2 * x * y * x_B[1] - 2 * w * y * x_B[2],
    )
    c, s = cos_sin(0.5 * yaw_weight * twist)
    return vector(2 * (x * c + y * s), 2 * (y * c - x * s), 2 * w * s)


def mix(thrust: Scalar, torque: Array) -> Array:
    """Motor commands (..., 4) in 0..1 from collective thrust (...,) and torque (..., 3).

    Without air mode: to keep roll and pitch the collective gives way upwards, never downwards; yaw takes what is left.
    """
    roll, pitch, yaw = components(torque)
    most = DIAGONAL * (abs(roll) + abs(pitch))  # the motors stand in all four quadrants
    level = scalar(thrust) - at_least(scalar(thrust) + most - 1.0, 0.0)
    return vector(*(clamp(level + left * roll - ahead * pitch + spin * yaw, 0.0, 1.0) for ahead, left, spin in _MOTORS))
