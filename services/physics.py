"""Constants of nature and the few quaternion and vector operations that several laws share.

Quaternions are unit, Hamilton, `q_AB_wxyz`: they take vectors from frame B to frame A. Everything broadcasts over leading
axes: vectors are (..., 3), quaternions (..., 4).

What runs up to 1000 times a second for one vehicle is written in components: `components` takes an array apart, `vector`
puts it together. Of one vehicle the components are plain floats, on which Python is fifteen times as quick as numpy is on
three numbers; of a crowd they are arrays. The formulae are the same, and what floats and arrays do differently is
in the small functions from `choose` to `cos_sin` below.
"""

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Scalar: TypeAlias = Any
"""A float; of a crowd an array (...,), which is as good as a float in any formula."""
Components: TypeAlias = Sequence[Scalar]
Row: TypeAlias = tuple[Scalar, Scalar, Scalar]

GRAVITY_MPS2 = 9.80665
Z = np.array([0.0, 0.0, 1.0])


def components(v: Array) -> list[Scalar]:
    """The last axis of (..., n) taken apart."""
    return v.tolist() if v.ndim == 1 else [v[..., i] for i in range(v.shape[-1])]


def vector(*components: Scalar) -> Array:
    """The counterpart of `components`, (..., n); a crowd's lie in memory component by component, to be taken apart."""
    if type(components[0]) is float is type(components[-1]):
        return np.array(components)
    try:
        together = np.array(components, dtype=np.float64)
    except ValueError:  # not all of the same shape
        together = np.empty((len(components), *np.broadcast(*components).shape))
        for i, component in enumerate(components):
            together[i] = component
    return together.T if together.ndim == 2 else np.moveaxis(together, 0, -1)


def scalar(x: Scalar) -> Scalar:
    """A float of an array without axes; what is a float, or has axes, as it is."""
    return x if type(x) is float or x.ndim else float(x)


def choose(flag: Scalar, if_so: Scalar, if_not: Scalar) -> Scalar:
    """`if_so` where the flag holds, else `if_not`."""
    if type(flag) is bool:
        return if_so if flag else if_not
    return np.where(flag, if_so, if_not)  # pyright: ignore[reportUnknownVariableType]


def at_least(x: Scalar, least: Scalar) -> Scalar:
    """`x`, or `least` where that is more; NaN stays."""
    return (least if x < least else x) if type(x) is float else np.maximum(x, least)


def clamp(x: Scalar, low: Scalar, high: Scalar) -> Scalar:
    """`x` kept between `low` and `high`; NaN stays."""
    return (low if x < low else high if x > high else x) if type(x) is float else np.minimum(np.maximum(x, low), high)


def anywhere(flag: Scalar) -> bool:
    """Whether the flag holds for anybody."""
    return flag if type(flag) is bool else bool(np.count_nonzero(flag))


def angle(y: Scalar, x: Scalar) -> Scalar:
    """Of the direction (x, y) from the x axis, in rad."""
    return math.atan2(y, x) if type(y) is float else np.arctan2(y, x)


def cos_sin(angle_rad: Scalar) -> tuple[Scalar, Scalar]:
    """Cosine and sine."""
    if type(angle_rad) is float:
        return math.cos(angle_rad), math.sin(angle_rad)
    return np.cos(angle_rad), np.sin(angle_rad)


def exp(x: Scalar) -> Scalar:
    """e to the power of x."""
    return math.exp(x) if type(x) is float else np.exp(x)


def dot(a: Array, b: Array) -> Array:
    """aᵀb over the last axis, (...,), rounded alike on every machine.

    BLAS, behind `@`, picks its kernel by the processor, and a rerun elsewhere would differ in the last bit.
    """
    return (a * b).sum(-1)


def norm(v: Array) -> Array:
    """‖v‖ over the last axis, (...,)."""
    return np.sqrt((v * v).sum(-1))


def saturate(v: Array, limit: Scalar) -> Array:
    """`v` shortened, direction kept, so that ‖v‖ <= limit; (..., n)."""
    parts = components(v)
    length = sum(x * x for x in parts) ** 0.5
    kept = clamp(limit / at_least(length, 1e-12), 0.0, 1.0)
    return vector(*(kept * x for x in parts))


def low_pass_gain(rate_rad_s: float, dt: float | Array) -> float | Array:
    """Exact step of `ẏ = rate (x - y)` with x held: y += gain (x - y)."""
    return 1.0 - np.exp(-rate_rad_s * dt)


def quaternion_product(a: Array, b: Array) -> Array:
    """a ⊗ b, (..., 4)."""
    aw, ax, ay, az = components(a)
    bw, bx, by, bz = components(b)
    return vector(
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(q: Array) -> Array:
    """q⁻¹ of a unit quaternion, (..., 4)."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def rotation_rows(q_AB_wxyz: Components) -> tuple[Row, Row, Row]:
    """The rows of R_AB in components."""
    w, x, y, z = q_AB_wxyz
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def rotation_matrix(q_AB_wxyz: Array) -> Array:
    """R_AB with v_A = R_AB v_B, (..., 3, 3)."""
    first, second, third = rotation_rows(components(q_AB_wxyz))
    return vector(*first, *second, *third).reshape(*q_AB_wxyz.shape[:-1], 3, 3)


def rotate(q_AB_wxyz: Array, v_B: Array) -> Array:
    """v_A = R_AB v_B, (..., 3)."""
    x, y, z = components(v_B)
    return vector(*(a * x + b * y + c * z for a, b, c in rotation_rows(components(q_AB_wxyz))))


def integrate_attitude(q_WB_wxyz: Array, omega_B_rad_s: Array, dt: float | Array) -> Array:
    """q after `dt` s at constant body rate (exact), (..., 4)."""
    angle = norm(omega_B_rad_s) * dt
    half_sinc = 0.5 * dt * np.sinc(angle / (2 * np.pi))
    dq = np.concatenate((np.cos(angle / 2)[..., None], omega_B_rad_s * np.asarray(half_sinc)[..., None]), axis=-1)
    q = quaternion_product(q_WB_wxyz, dq)
    return q / norm(q)[..., None]


def yaw_from(q_WB_wxyz: Array) -> Scalar:
    """Heading of the body's x axis from world x, about world z, rad, (...)."""
    w, x, y, z = components(q_WB_wxyz)
    return angle(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
