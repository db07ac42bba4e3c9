"""The path of the hand: a C2 piecewise polynomial through waypoints, by arc length, and the nearest point on it.

| paper | here | unit | frame |
|---|---|---|---|
| s ∈ [0, 1] | s, arc length over the whole length | | |
| p_H^d(s) | Path.p | m | W |
| ∇_s p_H^d / ‖∇_s p_H^d‖ | Path.t_hat | | W |
| p_H^d⊥(s) | Path.normal, to the left of the walk | | W |
| s*, pathProjection | project | | |

The path lies in the plane z = Path.z_m, the height of the hand (the paper's z = 0). All functions broadcast over s
(...) and p_H (..., 3).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from services.parameters import Fraction, Positive, parameters
from services.physics import Array

SAMPLES = 513
Curve = Callable[..., Any]


@parameters
class Trapezoid:
    """Profile of f_xy(s): f_start rising to f_max over the first part, f_max, falling to 0 over the last part."""

    f_start_N: Positive
    f_max_N: Positive
    ramp_up_fraction: Fraction
    ramp_down_fraction: Fraction


@parameters
class Obstacle:
    """A round post, drawn in figures; the path is given and does not steer by it."""

    x_m: float
    y_m: float
    radius_m: Positive


@dataclass(frozen=True, eq=False, kw_only=True)
class Path:
    """p_H^d(s) and its force profile. Build it with `through`, or read a file with `path_file.read`."""

    name: str
    waypoints_m: Array
    z_m: float
    length_m: float
    samples_m: Array
    force: Trapezoid
    obstacles: tuple[Obstacle, ...]
    xy_of_u: Curve
    u_of_s: Curve

    def p(self, s: ArrayLike) -> Array:
        """p_H^d(s) in m, (..., 3); s outside [0, 1] counts as the nearer end."""
        return _with_z(self.xy_of_u(self._u(s)), self.z_m)

    def t_hat(self, s: ArrayLike) -> Array:
        """Unit tangent in the direction of the walk, (..., 3)."""
        d = np.asarray(self.xy_of_u(self._u(s), 1))
        return _with_z(d / np.hypot(d[..., 0], d[..., 1])[..., None], 0.0)

    def normal(self, s: ArrayLike) -> Array:
        """Unit normal in the plane, to the left of the walk, (..., 3)."""
        t = self.t_hat(s)
        return np.stack((-t[..., 1], t[..., 0], t[..., 2]), axis=-1)

    def curvature(self, s: ArrayLike) -> Array:
        """Signed curvature in 1/m, (...): positive bends to the left."""
        u = self._u(s)
        d, dd = np.asarray(self.xy_of_u(u, 1)), np.asarray(self.xy_of_u(u, 2))
        return (d[..., 0] * dd[..., 1] - d[..., 1] * dd[..., 0]) / np.hypot(d[..., 0], d[..., 1]) ** 3

    def _u(self, s: ArrayLike) -> Array:
        return np.clip(self.u_of_s(np.clip(s, 0.0, 1.0)), 0.0, 1.0)


def through(
    waypoints_m: ArrayLike, z_m: float, force: Trapezoid, *, name: str = "", obstacles: tuple[Obstacle, ...] = ()
) -> Path:
    """The cubic spline (C2, not-a-knot, knots by chord length) through at least 3 waypoints (N, 2) at height `z_m`.

    Raises ValueError for too few waypoints or two equal ones in a row; `path_file.check` judges the shape.
    """
    w = np.asarray(waypoints_m, dtype=np.float64)
    if w.ndim != 2 or w.shape[1] != 2 or len(w) < 3:
        raise ValueError(f"waypoints_m = {w.shape[0]} points of shape {w.shape}: at least 3 points (x, y) are needed")
    chord = np.hypot(*np.diff(w, axis=0).T)
    if np.min(chord) < 1e-6:
        raise ValueError(f"waypoints_m: points {np.argmin(chord)} and {np.argmin(chord) + 1} are the same")
    xy: Curve = CubicSpline(np.append(0.0, np.cumsum(chord)) / np.sum(chord), w, bc_type="not-a-knot")
    length_m, u_of_s = _by_arc_length(xy)
    samples = np.asarray(xy(u_of_s(np.linspace(0.0, 1.0, SAMPLES))))
    return Path(
        name=name,
        waypoints_m=w,
        z_m=z_m,
        length_m=length_m,
        samples_m=samples,
        force=force,
        obstacles=obstacles,
        xy_of_u=xy,
        u_of_s=u_of_s,
    )


def project(p_H: Array, path: Path, s_guess: ArrayLike | None = None, window_m: float = 0.5) -> Array:
    """s* = argmin_s ‖p_H^d(s) - p_H‖ over the horizontal distance, (...): pathProjection.

    Without `s_guess` the minimum is global. With it, only points within `window_m` along the path from it count (G4):
    where the path comes back near itself s* then stays on its own branch instead of jumping. A hand that leaves its
    branch for good keeps s* at the edge of the window, which the bound on the rate of s* in `guiding` turns into a
    slow walk.
    """
    q = p_H[..., :2]
    grid = np.linspace(0.0, 1.0, SAMPLES)
    d = path.samples_m - q[..., None, :]
    d2 = d[..., 0] ** 2 + d[..., 1] ** 2
    lo, hi = np.zeros(q.shape[:-1]), np.ones(q.shape[:-1])
    if s_guess is not None:
        guess, reach = np.asarray(s_guess, dtype=np.float64), window_m / path.length_m
        lo, hi = np.maximum(guess - reach, 0.0), np.minimum(guess + reach, 1.0)
        d2 = np.where((grid >= lo[..., None]) & (grid <= hi[..., None]), d2, np.inf)
    s = grid[np.argmin(d2, axis=-1)]
    lo, hi = np.maximum(lo, s - grid[1]), np.minimum(hi, s + grid[1])
    for _ in range(2):  # samples are 8 mm apart on the reference path, and Newton squares the error
        s = np.clip(s + _newton_step(s, q, path), lo, hi)
    return s


def _newton_step(s: Array, q: Array, path: Path) -> Array:
    """-g/g' of g = (p - q)·t̂; near the centre of curvature, where g' vanishes, the caller's bracket holds the
    step."""
    u = path.u_of_s(s)
    r, d, dd = path.xy_of_u(u) - q, np.asarray(path.xy_of_u(u, 1)), np.asarray(path.xy_of_u(u, 2))
    speed2 = d[..., 0] ** 2 + d[..., 1] ** 2
    g = (r[..., 0] * d[..., 0] + r[..., 1] * d[..., 1]) / np.sqrt(speed2)
    bend = (d[..., 0] * dd[..., 1] - d[..., 1] * dd[..., 0]) * (r[..., 1] * d[..., 0] - r[..., 0] * d[..., 1])
    return -g / np.maximum(1.0 + bend / speed2**2, 0.1) / path.length_m


def _by_arc_length(xy: Curve) -> tuple[float, Curve]:
    """Length in m and u(s): 5-point Gauss on 1000 pieces, then a Hermite spline with the exact slopes du/ds."""
    nodes, weights = np.polynomial.legendre.leggauss(5)
    u = np.linspace(0.0, 1.0, 1001)
    inner = u[:-1, None] + 0.5 * (nodes + 1.0) * u[1]
    speed = np.hypot(*np.moveaxis(np.asarray(xy(inner, 1)), -1, 0))
    arc = np.append(0.0, np.cumsum(speed @ weights) * 0.5 * u[1])
    length = float(arc[-1])
    slope = length / np.hypot(*np.asarray(xy(u, 1)).T)
    return length, CubicHermiteSpline(arc / length, u, slope)


def _with_z(xy: Any, z: float) -> Array:
    xy = np.asarray(xy)
    return np.concatenate((xy, np.full((*xy.shape[:-1], 1), z)), axis=-1)
