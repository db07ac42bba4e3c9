"""Frames and units, and the only conversions between the autopilot's world and ours.

| frame | axes | origin |
|---|---|---|
| W | x, y horizontal, z up (ENU) | on the floor of the motion-capture volume |
| B | x forward, y left, z up (FLU) | the vehicle's centre of mass |
| NED, FRD | the autopilot's world and body | the same origins |

The paper's plane z = 0, the height at which the hand is held, is z = hand_height_m in W. Units are SI. A quaternion
`q_WB_wxyz` takes vectors from B to W. W's x axis is the autopilot's east: north = y, east = x.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SWAP, _DOWN = np.array([1, 0, 2]), np.array([1.0, 1.0, -1.0])
_RIGHT_DOWN = np.array([1.0, -1.0, -1.0])
# (0, √½, √½, 0) ⊗ q ⊗ (0, 1, 0, 0) as a matrix; q and -q are the same attitude
_HALF_TURNS = np.sqrt(0.5) * np.array([[1, 0, 0, 1], [0, 1, 1, 0], [0, 1, -1, 0], [1, 0, 0, -1]], dtype=np.float64)


def ned_from_enu(v: Array) -> Array:
    """(..., 3) world vectors; also enu_from_ned, the map is its own inverse."""
    return v[..., _SWAP] * _DOWN


enu_from_ned = ned_from_enu


def frd_from_flu(v: Array) -> Array:
    """(..., 3) body vectors; also flu_from_frd, the map is its own inverse."""
    return v * _RIGHT_DOWN


flu_from_frd = frd_from_flu


def q_enu_flu_from_ned_frd(q_wxyz: Array) -> Array:
    """q_WB_wxyz (..., 4) from the autopilot's q_NED_FRD: half a turn on either side."""
    return q_wxyz @ _HALF_TURNS


def q_ned_frd_from_enu_flu(q_WB_wxyz: Array) -> Array:
    """The inverse map; the same formula, for both factors are their own inverses up to sign."""
    return q_WB_wxyz @ _HALF_TURNS


def yaw_ned_from_enu(yaw_rad: float) -> float:
    """Heading from north, clockwise, of a heading from x, anticlockwise; its own inverse. In (-π, π]."""
    yaw = np.pi / 2 - yaw_rad
    return float(np.arctan2(np.sin(yaw), np.cos(yaw)))
