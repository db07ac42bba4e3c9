"""Constants of nature and the few quaternion and vector operations that several laws share.

Quaternions are unit, Hamilton, `q_AB_wxyz`: they take vectors from frame B to frame A. Everything broadcasts over leading
axes: vectors are (..., 3), quaternions (..., 4).
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GRAVITY_MPS2 = 9.80665
Z = np.array([0.0, 0.0, 1.0])


def norm(v: Array) -> Array:
    """‖v‖ over the last axis, (...,)."""
    return np.sqrt(np.sum(v * v, axis=-1))


def saturate(v: Array, limit: float | Array) -> Array:
    """`v` shortened, direction kept, so that ‖v‖ <= limit; (..., 3)."""
    length = norm(v)[..., None]
    return v * np.minimum(1.0, limit / np.maximum(length, 1e-12))


def low_pass_gain(rate_rad_s: float, dt: float | Array) -> float | Array:
    """Exact step of `ẏ = rate (x - y)` with x held: y += gain (x - y)."""
    return 1.0 - np.exp(-rate_rad_s * dt)


def quaternion_product(a: Array, b: Array) -> Array:
    """a ⊗ b, (..., 4)."""
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    return np.stack(
        (
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ),
        axis=-1,
    )


def conjugate(q: Array) -> Array:
    """q⁻¹ of a unit quaternion, (..., 4)."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def rotation_matrix(q_AB_wxyz: Array) -> Array:
    """R_AB with v_A = R_AB v_B, (..., 3, 3)."""
    w, x, y, z = (q_AB_wxyz[..., i] for i in range(4))
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rotate(q_AB_wxyz: Array, v_B: Array) -> Array:
    """v_A = R_AB v_B, (..., 3)."""
    return np.einsum("...ij,...j->...i", rotation_matrix(q_AB_wxyz), v_B)


def integrate_attitude(q_WB_wxyz: Array, omega_B_rad_s: Array, dt: float | Array) -> Array:
    """q after `dt` s at constant body rate (exact), (..., 4)."""
    angle = norm(omega_B_rad_s) * dt
    half_sinc = 0.5 * dt * np.sinc(angle / (2 * np.pi))
    dq = np.concatenate((np.cos(angle / 2)[..., None], omega_B_rad_s * np.asarray(half_sinc)[..., None]), axis=-1)
    q = quaternion_product(q_WB_wxyz, dq)
    return q / norm(q)[..., None]


def yaw_from(q_WB_wxyz: Array) -> Array:
    """Heading of the body's x axis from world x, about world z, rad, (...)."""
    w, x, y, z = (q_WB_wxyz[..., i] for i in range(4))
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
