# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
"""Least squares that say how good they are, and the best of one number on a grid. Pure."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from services.physics import Array


class Fit(NamedTuple):
    """x (n,) of A x = b; its standard errors (n,); what is left of b (N,); and how well A can tell the x apart.

    `condition` is that of A with its columns brought to unit length: 1 is best, at 1000 the x are as good as one.
    """

    x: Array
    sigma: Array
    left: Array
    condition: float

    @property
    def rms(self) -> float:
        """Of what is left."""
        return float(np.sqrt(np.mean(self.left**2)))


class Unfit(ValueError):
    """The data cannot answer; the text says what is missing."""


def least_squares(A: Array, b: Array) -> Fit:
    """Fit b (N,) by A (N, n). Raises Unfit where there are not more rows than columns, or a column is zero."""
    rows, columns = A.shape
    length = np.linalg.norm(A, axis=0)
    if rows <= columns or not np.all(length > 0.0):
        raise Unfit(f"{rows} usable values for {columns} unknowns")
    scaled = A / length
    singular = np.linalg.svd(scaled, compute_uv=False)
    if singular[-1] < 1e-9 * singular[0]:
        raise Unfit("the motion does not tell the unknowns apart")
    x = np.linalg.lstsq(scaled, b)[0] / length
    left = b - A @ x
    variance = float(left @ left) / (rows - columns)
    sigma = np.sqrt(variance * np.diag(np.linalg.inv(scaled.T @ scaled))) / length
    return Fit(x, sigma, left, float(singular[0] / singular[-1]))


def lowest(cost: Callable[[float], float], grid: Array) -> float:
    """Where `cost` is least: the best point of an even grid (n,), then the vertex of the parabola through its neighbours.

    A best point on the grid's edge stays there.
    """
    costs = np.array([cost(float(x)) for x in grid])
    best = int(np.argmin(costs))
    if best in (0, len(grid) - 1):
        return float(grid[best])
    before, here, after = costs[best - 1 : best + 2]
    bend = before - 2.0 * here + after
    step = float(grid[1] - grid[0])
    return float(grid[best]) + (0.5 * step * float((before - after) / bend) if bend > 0.0 else 0.0)


def windows(values: Array, use: NDArray[np.bool_], length: int) -> Array:
    """Means over consecutive `length` samples, of those windows of which every sample is used; (N, ...) to (M, ...)."""
    whole = len(values) // length
    shaped = values[: whole * length].reshape(whole, length, *values.shape[1:])
    return shaped.mean(axis=1)[use[: whole * length].reshape(whole, length).all(axis=1)]


def lagged(values: Array, dt_s: float, tau_s: float) -> Array:
    """`values` (N, ...) behind a first-order lag, which is settled at the first of them."""
    if tau_s <= 0.0:
        return values
    keep = np.exp(-dt_s / tau_s)
    return lfilter([1.0 - keep], [1.0, -keep], values, axis=0, zi=keep * values[:1])[0]
