"""The paper's numbers from recorded walks, as pure functions.

| paper | here | unit | frame |
|---|---|---|---|
| e_H(s), path-following error | path_error | m | W, left of the path positive |
| mean and std over runs | mean_over_runs, std_over_runs | m | |
| ‖e_H‖ = ‖p_H^r - p_H‖ | distance | m | W |

Source: the paper's "Experimental results" with E7 and E8. A walk is p_H (T, 3) in time order. What is of one walk is taken
of many of the same length at once, (..., T, 3), and is then an array (...).
"""

import numpy as np
from numpy.typing import NDArray

from services.guiding_controller.path import Path, project
from services.physics import Array, Scalar, norm

STRETCH = 16
WALKS = 64  # that are looked at at once


def path_error(p_H: Array, path: Path, s: Array) -> Array:
    """Signed lateral offset in m, (..., S), where the walk (..., T, 3) crosses the normal to the path at each s (S,).

    E7: of several crossings the one with the smallest magnitude; NaN where the walk never crosses that normal.
    """
    walks = p_H[..., :2].reshape(-1, p_H.shape[-2], 2)
    stations = path.p(s)[:, :2], path.t_hat(s)[:, :2], path.normal(s)[:, :2]
    errors = [_path_errors(walks[i : i + WALKS], *stations) for i in range(0, len(walks), WALKS)]
    return np.concatenate(errors).reshape(*p_H.shape[:-2], len(s))


def _path_errors(walks: Array, p: Array, t_hat: Array, normal: Array) -> Array:
    """The same for walks (N, T, 2) and stations (S, 2).

    A stretch of the walk that keeps within some distance of its first point crosses only the normals of stations that
    lie no further than that ahead or behind; the others are not looked at.
    """
    stretches = _stretches(walks)
    reach = np.max(norm(stretches - stretches[:, :, :1]), axis=-1)
    ahead = stretches[:, :, 0] @ t_hat.T - np.sum(p * t_hat, axis=-1)
    walk, stretch, station = np.nonzero(np.abs(ahead) <= reach[..., None] + 1e-9)
    x, y = np.moveaxis(stretches[walk, stretch] - p[station, None], -1, 0)
    along = x * t_hat[station, 0, None] + y * t_hat[station, 1, None]
    aside = x * normal[station, 0, None] + y * normal[station, 1, None]
    a, b = along[:, :-1], along[:, 1:]
    crosses = (a == 0.0) | (a * b < 0.0)
    row, column = np.nonzero(crosses)
    a, b = a[row, column], b[row, column]
    fraction = a / np.where(a == b, 1.0, a - b)
    offset = aside[row, column] + fraction * (aside[row, column + 1] - aside[row, column])
    order = np.argsort(-np.abs(offset), kind="stable")  # the smallest is written last
    errors = np.full((len(walks), len(p)), np.nan)
    errors[walk[row[order]], station[row[order]]] = offset[order]
    return errors


def _stretches(walks: Array) -> Array:
    """Walks (N, T, 2) cut into stretches (N, K, STRETCH + 1, 2) that share their ends; the last point is repeated."""
    count = -(-walks.shape[1] // STRETCH)
    ends = STRETCH * np.arange(count, dtype=np.int64)
    points: NDArray[np.int64] = np.add.outer(ends, np.arange(STRETCH + 1, dtype=np.int64))
    return walks[:, np.clip(points, 0, walks.shape[1] - 1)]


def mean_over_runs(errors: Array) -> Array:
    """Mean of the runs (N, S) that have a value at s, (S,); NaN where none has."""
    n = np.sum(np.isfinite(errors), axis=0)
    return np.where(n > 0, np.nansum(errors, axis=0) / np.maximum(n, 1), np.nan)


def std_over_runs(errors: Array) -> Array:
    """Sample standard deviation (E8: with the square root) of the runs (N, S), (S,); NaN for fewer than 2 values."""
    n = np.sum(np.isfinite(errors), axis=0)
    square = np.nansum((errors - mean_over_runs(errors)) ** 2, axis=0)
    return np.where(n > 1, np.sqrt(square / np.maximum(n - 1, 1)), np.nan)


def tube_diameter(errors: Array) -> float:
    """Diameter in m of the tube round the path that holds every run (N, S)."""
    return 2.0 * float(np.nanmax(np.abs(errors)))


def outward_drift(errors: Array, path: Path, s: Array) -> Array:
    """Mean offset to the outside of the path's bends in m, (...), of errors (..., S): where it bends at least half as
    sharply as anywhere; NaN where the walk has no value there."""
    curvature = path.curvature(s)
    bends = np.abs(curvature) >= 0.5 * np.max(np.abs(curvature))
    outward = -np.sign(curvature[bends]) * errors[..., bends]
    n = np.sum(np.isfinite(outward), axis=-1)
    return np.where(n > 0, np.nansum(outward, axis=-1) / np.maximum(n, 1), np.nan)


def distance(p_H: Array, path: Path) -> Array:
    """Horizontal distance of the hand from the nearest point of the path in m, (T,)."""
    return norm((p_H - path.p(project(p_H, path)))[..., :2])


def reference_error(p_H: Array, p_H_d: Array) -> Array:
    """‖e_H‖ = ‖p_H^d(s*) - p_H‖, horizontal, in m, (T,)."""
    return norm((p_H_d - p_H)[..., :2])


def slack_fraction(l_c: Array, rest_length_m: Scalar) -> Scalar:
    """Share of the samples (..., T, 3) with a slack cable, 0 to 1."""
    return np.mean(norm(l_c) <= np.asarray(rest_length_m)[..., None], axis=-1)


def arrival_time(t_s: Array, p_H: Array, path: Path, within_m: float) -> Scalar:
    """First time in s from which on the hand stays within `within_m` of the end of the path; NaN if never."""
    near = norm((p_H - path.p(1.0))[..., :2]) <= within_m
    stays = np.flip(np.logical_and.accumulate(np.flip(near, -1), axis=-1), -1)
    return np.where(stays[..., -1], t_s[np.argmax(stays, axis=-1)], np.nan)


def rms(x: Array) -> float:
    """Root mean square over time of a scalar (T,) or of a vector's length (T, 3)."""
    return float(np.sqrt(np.mean(np.sum(x * x, axis=-1) if x.ndim > 1 else x * x)))
