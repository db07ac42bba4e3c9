"""Paths from TOML files, and what makes a path unfit for guiding a person.

pathProjection needs a path that does not meet itself; E8's tube (60 cm) says how near is too near; the force must not
be zero before the end (the walk would stop there) and must be zero at the end (it would not).
"""

import tomllib
from pathlib import Path as File
from typing import Any, cast

import numpy as np

from services.guiding_controller.path import Obstacle, Path, Trapezoid, through
from services.physics import Array

LENGTH_MIN_M = 0.5
CLEARANCE_MIN_M = 0.6
RADIUS_MIN_M = 0.3
KEYS = {"name", "waypoints_m", "obstacles", "force"}


def read(file: str | File, z_m: float) -> Path:
    """The path in `file` at hand height `z_m`; ValueError names the file, the key, the value and the limit."""
    file = File(file)
    try:
        return build(tomllib.loads(file.read_text(encoding="utf-8")), z_m)
    except (ValueError, OSError) as error:
        raise ValueError(f"{file}: {error}") from error


def check(path: Path) -> None:
    """Raise ValueError for a path that is too short, too sharp, crosses itself or comes back too near to itself."""
    if path.length_m < LENGTH_MIN_M:
        raise ValueError(f"waypoints_m: the path is {path.length_m:.3f} m long, at least {LENGTH_MIN_M} m are needed")
    crossing = _first_crossing(path.samples_m)
    if crossing is not None:
        raise ValueError(f"waypoints_m: the path crosses itself at {crossing[0]:.2f}, {crossing[1]:.2f} (x, y in m)")
    if path.radius_min_m < RADIUS_MIN_M:
        raise ValueError(
            f"waypoints_m: smallest radius of curvature {path.radius_min_m:.2f} m, at least {RADIUS_MIN_M} m"
        )
    nearest = _clearance(path)
    if nearest < CLEARANCE_MIN_M:
        raise ValueError(
            f"waypoints_m: the path comes back to {nearest:.2f} m from itself, at least {CLEARANCE_MIN_M} m are needed"
        )


def build(table: dict[str, Any], z_m: float) -> Path:
    """The path of a file's content at hand height `z_m`; ValueError as `read`, without the file."""
    for key in table.keys() - KEYS:
        raise ValueError(f"{key} = {table[key]!r}: unknown key, known are {', '.join(sorted(KEYS))}")
    for key in ("name", "waypoints_m", "force"):
        if key not in table:
            raise ValueError(f"{key}: missing")
    posts = tuple(Obstacle(**_numbers("obstacles", post, Obstacle)) for post in table.get("obstacles", []))
    path = through(_waypoints(table["waypoints_m"]), z_m, _force(table["force"]), name=table["name"], obstacles=posts)
    check(path)
    return path


def _waypoints(value: Any) -> Array:
    try:
        points = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"waypoints_m = {value!r}: a list of [x, y] in m is needed") from None
    if not np.all(np.isfinite(points)):
        raise ValueError(f"waypoints_m = {value!r}: every coordinate must be finite")
    return points


def _force(table: Any) -> Trapezoid:
    f = Trapezoid(**_numbers("force", table, Trapezoid))
    if not f.f_start_N > 0.0:
        raise ValueError(f"force.f_start_N = {f.f_start_N}: must be > 0, else the walk never starts")
    if not f.f_max_N >= f.f_start_N:
        raise ValueError(f"force.f_max_N = {f.f_max_N}: must be >= f_start_N = {f.f_start_N}")
    if not f.ramp_down_fraction > 0.0:
        raise ValueError(f"force.ramp_down_fraction = {f.ramp_down_fraction}: must be > 0, the force must end at zero")
    if f.ramp_up_fraction < 0.0 or f.ramp_up_fraction + f.ramp_down_fraction > 1.0:
        raise ValueError(
            f"force.ramp_up_fraction = {f.ramp_up_fraction}: must be >= 0 and, with ramp_down_fraction = "
            f"{f.ramp_down_fraction}, at most 1"
        )
    return f


def _numbers(where: str, table: Any, kind: type) -> dict[str, float]:
    """The fields of `kind` in `table` as floats: nothing missing, nothing unknown, everything finite."""
    wanted: set[str] = set(kind.__annotations__)
    values = cast("dict[str, Any]", table) if isinstance(table, dict) else {}
    if set(values) != wanted:
        raise ValueError(f"{where} = {table!r}: exactly {', '.join(sorted(wanted))} are needed")
    for key, value in values.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
            raise ValueError(f"{where}.{key} = {value!r}: a finite number is needed")
    return {key: float(value) for key, value in values.items()}


def _first_crossing(points: Array) -> Array | None:
    """Where two pieces of the polyline (N, 2) that are not neighbours cross, or None."""
    a, d = points[:-1], np.diff(points, axis=0)
    offset = a[None, :] - a[:, None]
    cross = d[:, None, 0] * d[None, :, 1] - d[:, None, 1] * d[None, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along_i = (offset[..., 0] * d[None, :, 1] - offset[..., 1] * d[None, :, 0]) / cross
        along_j = (offset[..., 0] * d[:, None, 1] - offset[..., 1] * d[:, None, 0]) / cross
    inside = (along_i >= 0) & (along_i <= 1) & (along_j >= 0) & (along_j <= 1)
    i, j = np.nonzero(np.triu(inside, k=2))
    return None if i.size == 0 else a[i[0]] + along_i[i[0], j[0]] * d[i[0]]


def _clearance(path: Path) -> float:
    """Smallest distance in m between points that are further apart along the path than twice the clearance."""
    p = path.samples_m[::2]
    apart = np.abs(np.subtract.outer(np.arange(len(p)), np.arange(len(p)))) * path.length_m / (len(p) - 1)
    between = p[:, None] - p[None, :]
    distance = np.hypot(between[..., 0], between[..., 1])
    return float(np.min(np.where(apart > 2.0 * CLEARANCE_MIN_M, distance, np.inf)))
