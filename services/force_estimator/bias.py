"""What the observer wrongly calls cable force: weighed once in hover, then watched through the cable's geometry.

| paper | here | unit | frame |
|---|---|---|---|
| f̂_c of the observer | f_c | N | W |
| l_c = p_R - p_H | l_c | m | W |
| l̄ | rest_length_m | m | |

Source: G8 (the paper's observer has no bias). All of it in two steps: `tare` in hover with the weighed handle hanging
gives the bias there and then; `watch` follows what has changed since. The force for the filter is f̂_c - tare -
watched change. Vertical bias on a vertical cable stays invisible to `watch`. Broadcasts over leading axes.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from services.parameters import NonNegative, Positive, parameters
from services.physics import Array, Scalar, at_least, choose, components, norm, scalar, vector


@parameters
class Bias:
    """Limits of the tare and the pace of the watch."""

    handle_weight_N: NonNegative
    tare_s: Positive
    tare_std_max_N: Positive
    tare_bias_max_N: Positive
    watch_s: Positive
    slack_margin_m: Positive


class TareState(NamedTuple):
    """Time so far in s, (...), and the time integrals of f̂_c and of its square, (..., 3)."""

    t_s: Array
    sum_f: Array
    sum_f2: Array


class Tare(NamedTuple):
    """Bias and standard deviation in N, (..., 3); `reason` is empty when the tare may be used."""

    bias: Array
    std: Array
    reason: str


def tare_start(shape: tuple[int, ...] = ()) -> TareState:
    """Nothing averaged yet."""
    return TareState(np.zeros(shape), np.zeros((*shape, 3)), np.zeros((*shape, 3)))


def tare_step(state: TareState, f_c: Array, dt: ArrayLike) -> TareState:
    """Add one observer sample that held for `dt` s."""
    w = np.asarray(dt, dtype=np.float64)
    return TareState(state.t_s + w, state.sum_f + w[..., None] * f_c, state.sum_f2 + w[..., None] * f_c * f_c)


def tare_result(state: TareState, p: Bias) -> Tare:
    """Mean less the handle's weight; the handle may swing, so average over a few of its 2 s periods."""
    t = np.maximum(state.t_s, 1e-9)[..., None]
    mean = state.sum_f / t
    std = np.sqrt(np.maximum(state.sum_f2 / t - mean * mean, 0.0))
    bias = mean - p.handle_weight_N * np.array([0.0, 0.0, 1.0])
    return Tare(bias, std, _tare_reason(float(np.min(state.t_s)), std, bias, p))


def _tare_reason(t_s: float, std: Array, bias: Array, p: Bias) -> str:
    if t_s < p.tare_s * (1.0 - 1e-9):
        return f"averaged over {t_s:.2f} s, tare_s = {p.tare_s} s are needed"
    if np.max(std) > p.tare_std_max_N:
        return (
            f"force varies by {np.max(std):.2f} N (std), limit tare_std_max_N = {p.tare_std_max_N} N: is it hovering?"
        )
    if np.max(norm(bias)) > p.tare_bias_max_N:
        return (
            f"bias of {np.max(norm(bias)):.2f} N, limit tare_bias_max_N = {p.tare_bias_max_N} N: "
            "wrong mass, thrust or handle weight?"
        )
    return ""


def watch(
    change: Array,
    f_c: Array,
    l_c: Array,
    seen: Scalar,
    held: Scalar,
    dt: Scalar,
    rest_length_m: float,
    p: Bias,
) -> Array:
    """Bias change since the tare in N, (..., 3), one step on; `f_c` is f̂_c - tare, `l_c` comes from motion capture.

    Taut (or slack by less than the margin): what is across the cable is bias. Held and slack by more: all of it is.
    Handle not seen, or slack in nobody's hand (it may lie on something, or fall): frozen.
    """
    l_xyz, change_xyz = components(l_c), components(change)
    rest = [f - c for f, c in zip(components(f_c), change_xyz, strict=True)]
    length2 = sum(x * x for x in l_xyz)
    slack = length2**0.5 < rest_length_m - p.slack_margin_m
    along = sum(r * x for r, x in zip(rest, l_xyz, strict=True)) / at_least(length2, 1e-18)
    along = choose(slack, 0.0, along)  # what is along a taut cable is no bias
    counts = choose(slack, held, True) & seen
    gain = choose(counts, 1.0 - scalar(np.exp(-dt / p.watch_s)), 0.0)
    return vector(*(c + gain * (r - along * x) for c, r, x in zip(change_xyz, rest, l_xyz, strict=True)))


def is_slack(l_c: Array, rest_length_m: float, margin_m: float) -> NDArray[np.bool_]:
    """The cable is shorter than l̄ by more than `margin_m`, (...)."""
    return norm(l_c) < rest_length_m - margin_m
