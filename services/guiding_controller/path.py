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

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from services.guiding_controller.spline import Cubic, not_a_knot
from services.parameters import Fraction, Positive, parameters
from services.physics import Array, Row, Scalar, at_least, clamp, components, dot, scalar, vector

SAMPLES = 513
GRID = np.linspace(0.0, 1.0, SAMPLES)
SPACING = 1.0 / (SAMPLES - 1)
FINE = np.linspace(0.0, 1.0, 4 * SAMPLES - 3)
NEAR = 0.32
NEWTON_STEPS = 8
SETTLED = 1e-6  # of the whole path; the step after it is as its square


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
    xy_of_u: Cubic
    u_of_s: Cubic
    radius_min_m: float

    def p(self, s: ArrayLike) -> Array:
        """p_H^d(s) in m, (..., 3); s outside [0, 1] counts as the nearer end."""
        return self.p_and_t_hat(s)[0]

    def t_hat(self, s: ArrayLike) -> Array:
        """Unit tangent in the direction of the walk, (..., 3)."""
        return self.p_and_t_hat(s)[1]

    def p_and_t_hat(self, s: ArrayLike) -> tuple[Array, Array]:
        """Both at once, each (..., 3)."""
        (x, dx, _), (y, dy, _) = self.xy(s)
        speed = (dx * dx + dy * dy) ** 0.5
        return vector(x, y, self.z_m), vector(dx / speed, dy / speed, 0.0)

    def normal(self, s: ArrayLike) -> Array:
        """Unit normal in the plane, to the left of the walk, (..., 3)."""
        x, y, z = components(self.t_hat(s))
        return vector(-y, x, z)

    def curvature(self, s: ArrayLike) -> Scalar:
        """Signed curvature in 1/m, (...): positive bends to the left."""
        (_, dx, ddx), (_, dy, ddy) = self.xy(s)
        return (dx * ddy - dy * ddx) / (dx * dx + dy * dy) ** 1.5

    def xy(self, s: ArrayLike) -> tuple[Row, Row]:
        """x and y in m with their first two derivatives by the spline's own parameter."""
        s = s if type(s) is float else scalar(np.asarray(s, dtype=np.float64))
        (u,) = self.u_of_s.values(clamp(s, 0.0, 1.0))
        x, y = self.xy_of_u.at(clamp(u, 0.0, 1.0))
        return x, y


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
    knots = np.append(0.0, np.cumsum(chord)) / np.sum(chord)
    xy = Cubic(knots, w, not_a_knot(knots, w))
    length_m, u_of_s = _by_arc_length(xy)
    samples, _ = xy.sampled(u_of_s.sampled(GRID)[0][:, 0])
    path = Path(
        name=name,
        waypoints_m=w,
        z_m=z_m,
        length_m=length_m,
        samples_m=samples,
        force=force,
        obstacles=obstacles,
        xy_of_u=xy,
        u_of_s=u_of_s,
        radius_min_m=np.inf,
    )
    return replace(path, radius_min_m=1.0 / max(float(np.max(np.abs(path.curvature(FINE)))), 1e-9))


def project(p_H: Array, path: Path, s_guess: ArrayLike | None = None, window_m: float = 0.5) -> Scalar:
    """s* = argmin_s ‖p_H^d(s) - p_H‖ over the horizontal distance, (...): pathProjection.

    Without `s_guess` the minimum is global. With it, only points within `window_m` along the path from it count (G4):
    where the path comes back near itself s* then stays on its own branch instead of jumping. A hand that leaves its
    branch for good keeps s* at the edge of the window, which the bound on the rate of s* in `guiding` turns into a
    slow walk.
    """
    x, y, *_ = components(p_H)
    if s_guess is None:
        return _search(x, y, 0.0, 1.0, path)
    guess, reach = scalar(np.asarray(s_guess, dtype=np.float64)), window_m / path.length_m
    lo, hi = at_least(guess - reach, 0.0), clamp(guess + reach, 0.0, 1.0)
    s, proven = _near(guess, x, y, lo, hi, path)
    if type(proven) is bool:
        return s if proven else _search(x, y, lo, hi, path)
    if not proven.all():
        s[~proven] = _search(x[~proven], y[~proven], lo[~proven], hi[~proven], path)
    return s


def _near(guess: Scalar, x: Scalar, y: Scalar, lo: Scalar, hi: Scalar, path: Path) -> tuple[Scalar, Scalar]:
    """Newton from the guess, and whether what it found is the global minimum of the window.

    It is, if the distance d there is short against the smallest radius of curvature R. Within an arc a of it the squared
    distance is convex while d + a < R; and an arc longer than a = 2 R asin(d/R) has a chord longer than 2 d, so that
    its far end is further from the hand than d (Schur's comparison theorem, for arcs up to π R). Both hold for
    d < 0.32 R in a window shorter than π R.
    """
    s, settled, distance2 = guess, False, math.inf
    for _ in range(NEWTON_STEPS):
        step, distance2 = _newton_step(s, x, y, path)
        before, s = s, clamp(s + step, lo, hi)
        settled = abs(s - before) < SETTLED
        if settled if type(settled) is bool else settled.all():
            break
    radius = path.radius_min_m / path.length_m
    return s, settled & (hi - lo < math.pi * radius) & (distance2 < (NEAR * path.radius_min_m) ** 2)


def _search(x: Scalar, y: Scalar, lo: Scalar, hi: Scalar, path: Path) -> Scalar:
    """The nearest sample with lo <= s <= hi, then Newton inside its bracket."""
    d2 = np.subtract.outer(x, path.samples_m[:, 0]) ** 2 + np.subtract.outer(y, path.samples_m[:, 1]) ** 2
    d2 = np.where(np.less_equal.outer(lo, GRID) & np.greater_equal.outer(hi, GRID), d2, np.inf)
    s = scalar(GRID[np.argmin(d2, axis=-1)])
    lo, hi = at_least(s - SPACING, lo), clamp(s + SPACING, 0.0, hi)
    for _ in range(2):  # samples are 8 mm apart on the reference path, and Newton squares the error
        s = clamp(s + _newton_step(s, x, y, path)[0], lo, hi)
    return s


def _newton_step(s: Scalar, x: Scalar, y: Scalar, path: Path) -> tuple[Scalar, Scalar]:
    """-g/g' of g = (p - q)·t̂, and the squared distance in m²; near the centre of curvature, where g' vanishes, the
    caller's bracket holds the step."""
    (x_d, dx, ddx), (y_d, dy, ddy) = path.xy(s)
    r_x, r_y, speed2 = x_d - x, y_d - y, dx * dx + dy * dy
    g = (r_x * dx + r_y * dy) / speed2**0.5
    bend = (dx * ddy - dy * ddx) * (r_y * dx - r_x * dy)
    step = -g / at_least(1.0 + bend / (speed2 * speed2), 0.1) / path.length_m
    return step, r_x * r_x + r_y * r_y


def _by_arc_length(xy: Cubic) -> tuple[float, Cubic]:
    """Length in m and u(s): 5-point Gauss on 1000 pieces, then a Hermite spline with the exact slopes du/ds.

    The spline is made again on knots that are even in s, which are quicker to find one's place among.
    """
    nodes, weights = np.polynomial.legendre.leggauss(5)
    u = np.linspace(0.0, 1.0, 1001)
    inner = u[:-1, None] + 0.5 * (nodes + 1.0) * u[1]
    speed = np.hypot(*np.moveaxis(xy.sampled(inner)[1], -1, 0))
    arc = np.append(0.0, np.cumsum(dot(speed, weights)) * 0.5 * u[1])
    length = float(arc[-1])
    even = np.linspace(0.0, 1.0, len(u))
    uneven, _ = Cubic(arc / length, u[:, None], _slope(xy, u, length)).sampled(even)
    u = np.clip(uneven[:, 0], 0.0, 1.0)
    return length, Cubic(even, u[:, None], _slope(xy, u, length))


def _slope(xy: Cubic, u: Array, length_m: float) -> Array:
    """du/ds, (N, 1)."""
    return (length_m / np.hypot(*xy.sampled(u)[1].T))[:, None]
