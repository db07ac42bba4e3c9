"""The paper's statistics of many walks, simulated or recorded: one row for each walk, and what they have in common.

| paper | here | unit |
|---|---|---|
| e_H(s) of each run | Result.errors | m, left of the path positive |
| mean and std over the runs | Common.mean_m, Common.std_m | m |
| the tube that holds everyone | Common.tube_m | m |
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from services.campaign.population import Columns
from services.guiding_controller.path import Path
from services.physics import Array, Scalar, norm
from services.recorder import metrics

STATIONS = np.linspace(0.0, 1.0, 401)
"""s at which the path error is taken."""
ARRIVED_M = 0.10
PAPER_MEAN_M, PAPER_STD_M, PAPER_TUBE_M = 0.05, 0.10, 0.60
"""The paper's results: mean path error for every s, its standard deviation, the tube's diameter."""
_AT_ONCE = 50


@dataclass(frozen=True, eq=False)
class Result:
    """Walks along one path: `columns` (N,), `errors` (N, S) at STATIONS, and where the first walks went, (T, 2) m each."""

    path: Path
    columns: Columns
    errors: Array
    traces: Sequence[Array]
    varied: Sequence[str] = ()
    """The columns that were varied on purpose."""


@dataclass(frozen=True, eq=False)
class Common:
    """Over all walks, at STATIONS (S,): mean and std (the paper's), the outermost; and the tube's diameter."""

    mean_m: Array
    std_m: Array
    low_m: Array
    high_m: Array
    tube_m: float


def of_walks(t_s: Array, p_H: Array, p_R: Array, path: Path, rest_length_m: Scalar) -> tuple[Columns, Array]:
    """What a walk's places say: columns (N,) and errors (N, S) of walks (N, T, 3)."""
    errors = metrics.path_error(p_H, path, STATIONS)
    size = np.abs(errors)
    n = np.sum(np.isfinite(size), axis=-1)
    return {
        "error_mean_m": np.where(n > 0, np.nansum(size, axis=-1) / np.maximum(n, 1), np.nan),
        "error_max_m": np.where(n > 0, np.max(np.nan_to_num(size), axis=-1), np.nan),
        "outward_m": metrics.outward_drift(errors, path, STATIONS),
        "end_error_m": norm((p_H[..., -1, :] - path.p(1.0))[..., :2]),
        "arrival_s": metrics.arrival_time(t_s - t_s[0], p_H, path, ARRIVED_M),
        "slack_fraction": metrics.slack_fraction(p_R - p_H, rest_length_m),
    }, errors


def common(errors: Array) -> Common:
    """What all walks (N, S) have in common; a few stations at a time, so that many walks need little memory.

    Mean and std are those of the stations that at least half of the walks pass: near the end few do.
    """
    parts = [errors[:, i : i + _AT_ONCE] for i in range(0, errors.shape[1], _AT_ONCE)]
    mean = np.concatenate([metrics.mean_over_runs(part) for part in parts])
    std = np.concatenate([metrics.std_over_runs(part) for part in parts])
    few = np.concatenate([np.mean(np.isfinite(part), axis=0) < 0.5 for part in parts])
    mean[few] = std[few] = np.nan
    low = np.concatenate([np.fmin.reduce(part, axis=0) for part in parts])
    high = np.concatenate([np.fmax.reduce(part, axis=0) for part in parts])
    return Common(mean, std, low, high, 2.0 * float(np.nanmax(np.maximum(-low, high), initial=0.0)))


def persons(columns: Columns) -> Columns:
    """One row for each person: the mean of what was measured in their walks, NaN left out."""
    numbers, first, which = np.unique(columns["person"], return_index=True, return_inverse=True)
    rows: Columns = {"person": numbers, "walks": np.bincount(which).astype(float)}
    for name in columns.keys() - {"person", "trial"}:
        known = np.isfinite(columns[name])
        n = np.bincount(which, known)
        total = np.bincount(which, np.where(known, columns[name], 0.0))
        rows[name] = np.where(n > 0, total / np.maximum(n, 1), columns[name][first])
    return rows
