"""Piecewise cubics made by scipy, evaluated by Horner's rule: one place in floats, many in arrays, as in services/physics.

| here | meaning |
|---|---|
| u | where: the piece and the way into it, h |
| value, slope, bend | the cubic and its first and second derivatives by u |
"""

from bisect import bisect_right
from typing import Any

import numpy as np

from services.physics import Array, Row, Scalar


class Cubic:
    """A piecewise cubic of u in one or more dimensions; beyond its ends the first and the last piece go on."""

    def __init__(self, made: Any) -> None:
        """From one of scipy's piecewise polynomials of degree 3."""
        self._starts: Array = made.x[:-1]
        self._pieces = np.moveaxis(made.c.reshape(4, len(self._starts), -1), 0, -1)  # piece, dimension, power
        self._starts_list, self._pieces_list = self._starts.tolist(), self._pieces.tolist()
        step = float(made.x[1] - made.x[0])
        self._per_piece = 1.0 / step if np.allclose(np.diff(made.x), step, 1e-9, 0.0) else 0.0  # 0: not even
        self._rows = np.moveaxis(self._pieces, 0, -1).reshape(-1, len(self._starts))  # (dimension and power), piece

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
