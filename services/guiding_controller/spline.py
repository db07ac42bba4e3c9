"""Piecewise cubics evaluated by Horner's rule: one place in floats, many in arrays, as in services/physics.

| here | meaning |
|---|---|
| u | where: the piece and the way into it, h |
| value, slope, bend | the cubic and its first and second derivatives by u |

Made here and not by scipy: its import was a third of the time in which a service starts, and one that was killed is waited
for in flight; its LAPACK may differ in the last bits from one machine to the next. The steps are those of scipy's
CubicSpline and CubicHermiteSpline, so that the bits are too.
"""

from bisect import bisect_right

import numpy as np

from services.physics import Array, Row, Scalar


class Cubic:
    """A piecewise cubic of u in one or more dimensions; beyond its ends the first and the last piece go on."""

    def __init__(self, knots: Array, values: Array, slopes: Array) -> None:
        """With these values and slopes, each (N, dimensions), at the knots (N)."""
        step = np.diff(knots)[:, None]
        chord = np.diff(values, axis=0) / step
        turn = (slopes[:-1] + slopes[1:] - 2 * chord) / step
        self._powers = np.stack((turn / step, (chord - slopes[:-1]) / step - turn, slopes[:-1], values[:-1]))
        self._starts: Array = knots[:-1]
        self._pieces = np.moveaxis(self._powers, 0, -1)  # piece, dimension, power
        self._starts_list, self._pieces_list = self._starts.tolist(), self._pieces.tolist()
        even = float(knots[1] - knots[0])
        self._per_piece = 1.0 / even if np.allclose(np.diff(knots), even, 1e-9, 0.0) else 0.0  # 0: not even
        self._rows = np.moveaxis(self._pieces, 0, -1).reshape(-1, len(self._starts))  # (dimension and power), piece

    def sampled(self, u: Array) -> tuple[Array, Array]:
        """Values and slopes at u (...), each (..., dimensions): summed by powers, as scipy does."""
        i = np.clip(np.searchsorted(self._starts, u, side="right") - 1, 0, None)
        h, (a, b, c, d) = (u - self._starts[i])[..., None], self._powers[:, i]
        return d + c * h + b * (h * h) + a * (h * h * h), c + b * h * 2.0 + a * (h * h) * 3.0

    def at(self, u: Scalar) -> list[Row]:
        """For each dimension value, slope and bend at u, each as u is: a float, or (...)."""
        if type(u) is float:
            i = max(bisect_right(self._starts_list, u) - 1, 0)
            return [_horner(u - self._starts_list[i], *powers) for powers in self._pieces_list[i]]
        h, powers = self._found(u)
        return [_horner(h, *powers[k : k + 4]) for k in range(0, len(powers), 4)]

    def values(self, u: Scalar) -> list[Scalar]:
        """For each dimension only the value."""
        if type(u) is float:
            return [value for value, _, _ in self.at(u)]
        h, rows = self._found(u)
        return [((a * h + b) * h + c) * h + d for a, b, c, d in rows.reshape(-1, 4, *rows.shape[1:])]

    def _found(self, u: Array) -> tuple[Array, Array]:
        """For a crowd: how far into its piece each u (...) is, and the powers' factors, one row each."""
        if self._per_piece:
            i = ((u - self._starts[0]) * self._per_piece).astype(np.intp)
        else:
            i = np.searchsorted(self._starts, u, side="right") - 1
        i = np.minimum(np.maximum(i, 0), len(self._starts) - 1)
        return u - self._starts.take(i), self._rows.take(i, axis=1)


def _horner(h: Scalar, a: Scalar, b: Scalar, c: Scalar, d: Scalar) -> Row:
    """a h³ + b h² + c h + d with its derivatives."""
    return ((a * h + b) * h + c) * h + d, (3.0 * a * h + 2.0 * b) * h + c, 6.0 * a * h + 2.0 * b


def not_a_knot(knots: Array, values: Array) -> Array:
    """Slopes (N, dimensions) of the C2 cubic through the values; its first two pieces are one, and its last two.

    Through three values it is a parabola.
    """
    x, h = knots, np.diff(knots)[:, None]
    chord, n = np.diff(values, axis=0) / h, len(knots)
    rows, right = np.zeros((n, n)), np.empty_like(values)
    for i in range(1, n - 1):
        rows[i, i - 1 : i + 2] = h[i, 0], 2 * (h[i - 1, 0] + h[i, 0]), h[i - 1, 0]
    right[1:-1] = 3 * (h[1:] * chord[:-1] + h[:-1] * chord[1:])
    if n == 3:  # both conditions would be the same
        rows[0, :2] = rows[2, 1:] = 1.0
        right[0], right[2] = 2 * chord[0], 2 * chord[1]
    else:
        first, last = x[2] - x[0], x[-1] - x[-3]
        rows[0, :2], rows[-1, -2:] = (h[1, 0], first), (last, h[-2, 0])
        right[0] = ((h[0] + 2 * first) * h[1] * chord[0] + h[0] ** 2 * chord[1]) / first
        right[-1] = (h[-1] ** 2 * chord[-2] + (2 * last + h[-1]) * h[-2] * chord[-1]) / last
    return _solved(rows, right)


def _solved(rows: Array, right: Array) -> Array:
    """Of a tridiagonal system: elimination with exchange of neighbours, then backwards, as LAPACK's gtsv."""
    last = len(right) - 1
    for i in range(last):
        if abs(rows[i + 1, i]) > abs(rows[i, i]):
            rows[[i, i + 1]], right[[i, i + 1]] = rows[[i + 1, i]], right[[i + 1, i]]
        factor = rows[i + 1, i] / rows[i, i]
        rows[i + 1] -= factor * rows[i]
        right[i + 1] -= factor * right[i]
    for i in range(last, -1, -1):
        for k in range(i + 1, min(i + 2, last) + 1):
            right[i] -= rows[i, k] * right[k]
        right[i] /= rows[i, i]
    return right
