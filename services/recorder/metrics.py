"""The paper's numbers from recorded walks, as pure functions.

| paper | here | unit | frame |
|---|---|---|---|
| e_H(s), path-following error | path_error | m | W, left of the path positive |
| mean and std over runs | mean_over_runs, std_over_runs | m | |
| ‖e_H‖ = ‖p_H^r - p_H‖ | distance | m | W |

Source: the paper's "Experimental results" with E7 and E8. A walk is p_H (T, 3) in time order.
"""

import numpy as np

from services.guiding_controller.path import Path, project
from services.physics import Array, norm


def path_error(p_H: Array, path: Path, s: Array) -> Array:
    """Signed lateral offset in m, (S,), where the walk (T, 3) crosses the normal to the path at each s (S,).

    E7: of several crossings the one with the smallest magnitude; NaN where the walk never crosses that normal.
    """
    r = p_H[:, None, :2] - path.p(s)[None, :, :2]
    along = np.sum(r * path.t_hat(s)[:, :2], axis=-1)
    aside = np.sum(r * path.normal(s)[:, :2], axis=-1)
    a, b = along[:-1], along[1:]
    crosses = (a == 0.0) | (a * b < 0.0)
    fraction = np.where(crosses, a / np.where(a == b, 1.0, a - b), 0.0)
    offset = np.where(crosses, aside[:-1] + fraction * (aside[1:] - aside[:-1]), np.inf)
    offset = np.vstack((offset, np.where(along[-1] == 0.0, aside[-1], np.inf)))
    best = np.take_along_axis(offset, np.argmin(np.abs(offset), axis=0)[None], axis=0)[0]
    return np.where(np.isfinite(best), best, np.nan)


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


def distance(p_H: Array, path: Path) -> Array:
    """Horizontal distance of the hand from the nearest point of the path in m, (T,)."""
    return norm((p_H - path.p(project(p_H, path)))[..., :2])


def reference_error(p_H: Array, p_H_d: Array) -> Array:
    """‖e_H‖ = ‖p_H^d(s*) - p_H‖, horizontal, in m, (T,)."""
    return norm((p_H_d - p_H)[..., :2])


def slack_fraction(l_c: Array, rest_length_m: float) -> float:
    """Share of the samples (T, 3) with a slack cable, 0 to 1."""
    return float(np.mean(norm(l_c) <= rest_length_m))


def arrival_time(t_s: Array, p_H: Array, path: Path, within_m: float) -> float:
    """First time in s from which on the hand stays within `within_m` of the end of the path; NaN if never."""
    near = norm((p_H - path.p(1.0))[..., :2]) <= within_m
    stays = np.flip(np.logical_and.accumulate(np.flip(near)))
    return float(t_s[np.argmax(stays)]) if np.any(stays) else float("nan")


def rms(x: Array) -> float:
    """Root mean square over time of a scalar (T,) or of a vector's length (T, 3)."""
    return float(np.sqrt(np.mean(np.sum(x * x, axis=-1) if x.ndim > 1 else x * x)))
