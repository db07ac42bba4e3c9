"""Where O_H is in the frame of the handle's markers, by turning the handle about it.

| paper | here | unit | frame |
|---|---|---|---|
| marker body: origin, attitude | p, q_WB_wxyz | m | W |
| O_H in that body | offset | m | handle |
| O_H while it is held still | pivot | m | W |

Hold the point where the cable leaves the handle still, and turn the handle about it to all sides: p_i + R_i offset = pivot in
every frame, which is linear in both. Turning about one axis alone leaves the offset along it open: the condition says so.
"""

from typing import NamedTuple

import numpy as np

from services.calibration.fit import Fit, Unfit, least_squares
from services.physics import Array, rotation_matrix

SPREAD_MIN = 0.1
"""Of the attitudes, in every direction: about 15° to each side."""


class HandleFit(NamedTuple):
    """O_H in the handle's frame and where it was held, (3,) m; `left_m` is the rms distance from it."""

    offset: Array
    pivot: Array
    left_m: float
    spread: float
    fit: Fit


def handle(p: Array, q_WB_wxyz: Array) -> HandleFit:
    """From poses (N, 3), (N, 4). Raises Unfit where they turn too little, or about one axis alone."""
    if len(p) < 10:
        raise Unfit(f"{len(p)} poses of the handle, at least 10 are needed")
    R = rotation_matrix(q_WB_wxyz)
    turned, moved = R - R.mean(axis=0), p - p.mean(axis=0)
    A = turned.reshape(-1, 3)
    spread = float(np.linalg.svd(A, compute_uv=False)[-1] / np.sqrt(len(p)))
    if spread < SPREAD_MIN:
        raise Unfit(
            f"the handle turned too little (spread {spread:.3f}, at least {SPREAD_MIN:g}): tilt it 30° to all sides"
        )
    fit = least_squares(A, -moved.reshape(-1))
    pivot: Array = (p + R @ fit.x).mean(axis=0)
    left_m = float(np.sqrt(3.0)) * fit.rms
    return HandleFit(fit.x, pivot, left_m, spread, fit)
