"""Is the handle held? A wrong yes pulls with nobody there, a wrong no only makes the person wait: yes is earned.

| paper | here | unit | frame |
|---|---|---|---|
| p_H, v_H (the handle) | p_H, v_H | m, m/s | W |
| l_c = p_R - p_H | from p_R, p_H | m | W |
| f̂_c | f_c, bias removed | N | W |
| u_A | u_A, as applied by the filter | N | W |

Source: G6. Nobody on the handle means one of two things: it hangs (cable taut, force = its own weight, a pendulum),
or it falls.

Lost, any one of:
- OFF_PLANE, FAST: more than 12 cm off the hand plane, or faster than 1 m/s. At once; needs the handle in sight.
- WEIGHT_ONLY: for 0.3 s the filter asks for more than the handle's weight (0.5 N along, or 0.3 N up at the end of the
  path, where the drone stands above the hand and motion capture sees no difference), yet the cable carries just that
  weight. Not while the cable is slack: there a hand holds the handle up. Works out of sight.

Taken, all of: in sight, within 8 cm of the plane, slower than 0.2 m/s, and for 0.5 s on end a sign in the geometry that
something carries the handle, which a hanging one cannot show:
- slack by more than 3 cm (a free handle would fall 1.2 m in that time), and the force agrees: no more than the weight
  plus 0.25 N;
- taut but more than 10 cm off the vertical under the drone, and slow: a pendulum comes back within half a second.
The force alone is no such sign: a bias that jumps by 0.3 N looks just like a hand that loads the handle.

The free handle's force is followed slowly (5 s) while it hangs, and WEIGHT_ONLY compares with that rather than with the
weighed value, so a drift of the bias before the taking does no harm.

Errors, and what they cost. Gripped, or loaded straight down, without lifting or drawing it aside: not held until the
person lifts it. So let the handle hang 10 cm below the plane (a waiting robot, rid of the weight, rises by weight/K_z and
takes some of the slack away), and tell the person to take it up. Quick gestures over 1 m/s, or a hand 12 cm off: lost,
the pull stops, taken again after 0.5 s. Handle on a table of the plane's height, or a snagged cable: wrongly taken, and
WEIGHT_ONLY cannot see it; so the operator starts guiding, not this rule. Bias jump of more than 0.2 N in the air:
WEIGHT_ONLY is blind to a hand that lets go at the end of the path, where the drone then hangs over the handle, below
its ceiling, without a horizontal pull. Everything broadcasts over leading axes.
"""

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from services.parameters import NonNegative, Positive, parameters
from services.physics import Array, Components, Scalar, Z, choose, components, scalar, vector

Flags = Scalar
"""A bool; of a crowd an array (...,) of them."""
SLACK_SEEN_M = 0.01  # what motion capture makes of a taut cable is not shorter than this


class Why(IntEnum):
    """The reason for the present answer."""

    HELD = 0
    NOT_TAKEN = 1
    OFF_PLANE = 2
    FAST = 3
    WEIGHT_ONLY = 4


@parameters
class Held:
    """Limits of the rule; see the module's text."""

    handle_weight_N: NonNegative
    off_plane_m: Positive
    fast_mps: Positive
    f_along_min_N: Positive
    f_up_min_N: Positive
    f_along_felt_max_N: Positive
    f_up_tolerance_N: Positive
    lost_s: Positive
    take_band_m: Positive
    take_speed_mps: Positive
    take_slack_m: Positive
    take_aside_m: Positive
    take_force_N: Positive
    take_s: Positive
    reference_s: Positive


class State(NamedTuple):
    """Held?, why, how long each sign has lasted in s, all (...), and the free handle's force in N, (..., 3)."""

    held: NDArray[np.bool_]
    why: NDArray[np.int64]
    weight_only_s: Scalar
    carried_s: Scalar
    f_free: Array


class Input(NamedTuple):
    """One tick: handle and robot in m, m/s, (..., 3), is the handle seen (...); forces in N, (..., 3)."""

    p_H: Array
    v_H: Array
    seen: Flags
    p_R: Array
    f_c: Array
    u_A: Array


def start(p: Held, shape: tuple[int, ...] = ()) -> State:
    """Not taken yet; the free handle's force is its weight until it is measured."""
    zero = np.zeros(shape)
    why = np.full(shape, int(Why.NOT_TAKEN), dtype=np.int64)
    return State(np.zeros(shape, dtype=bool), why, zero, zero, zero[..., None] + p.handle_weight_N * Z)


def step(state: State, x: Input, dt: float, plane_z_m: float, rest_length_m: float, p: Held) -> tuple[State, Flags]:
    """Advance by `dt` s; returns the state and whether the handle is held, (...)."""
    p_H, l_c, f_c, f_free = components(x.p_H), components(x.p_R - x.p_H), components(x.f_c), components(state.f_free)
    df = [f - free for f, free in zip(f_c, f_free, strict=True)]
    slack_m, off_m, speed = rest_length_m - _length(l_c), abs(p_H[2] - plane_z_m), _length(components(x.v_H))
    weight_only = _weight_only(components(x.u_A), df, p) & choose(x.seen, slack_m <= SLACK_SEEN_M, True)
    weight_only_s = choose(weight_only, scalar(state.weight_only_s) + dt, 0.0)
    carried, calm = _carried(l_c, slack_m, _length(f_c), p), x.seen & (speed < p.take_speed_mps)
    carried_s = choose(carried & calm & (off_m < p.take_band_m), scalar(state.carried_s) + dt, 0.0)
    was = scalar(state.why)
    why = _why(was, x.seen & (off_m > p.off_plane_m), x.seen & (speed > p.fast_mps), weight_only_s, carried_s, p)
    held = why == Why.HELD
    follow = choose(calm, 1.0 - math.exp(-dt / p.reference_s), 0.0)
    gain = choose(held | (was == Why.HELD) | carried, 0.0, follow)
    f_free = vector(*(free + gain * d for free, d in zip(f_free, df, strict=True)))
    after = State(np.asarray(held), np.asarray(why, np.int64), weight_only_s, choose(held, 0.0, carried_s), f_free)
    return after, after.held


def _length(v: Components) -> Scalar:
    return sum(x * x for x in v) ** 0.5


def _weight_only(u_A: Components, df: Components, p: Held) -> Flags:
    """More than the weight is asked for, no more than the free handle's force is felt."""
    asked = (_length(u_A[:2]) > p.f_along_min_N) | (u_A[2] - p.handle_weight_N > p.f_up_min_N)
    return asked & (_length(df[:2]) <= p.f_along_felt_max_N) & (abs(df[2]) <= p.f_up_tolerance_N)


def _carried(l_c: Components, slack_m: Scalar, pull_N: Scalar, p: Held) -> Flags:
    """A sign that something other than the cable carries the handle."""
    slack = (slack_m > p.take_slack_m) & (pull_N < p.handle_weight_N + p.take_force_N)
    return slack | ((_length(l_c[:2]) > p.take_aside_m) & (slack_m <= p.take_slack_m))


def _why(was: Scalar, off: Flags, fast: Flags, weight_only_s: Scalar, carried_s: Scalar, p: Held) -> Scalar:
    """The new reason; a lost handle keeps the reason it was lost for until it is taken again."""
    by_force = choose(weight_only_s >= p.lost_s - 1e-9, Why.WEIGHT_ONLY, Why.HELD)
    while_held = choose(off, Why.OFF_PLANE, choose(fast, Why.FAST, by_force))
    while_free = choose(carried_s >= p.take_s - 1e-9, Why.HELD, was)
    return choose(was == Why.HELD, while_held, while_free)


def reason(why: ArrayLike) -> str:
    """One word for a message or a log line, of a single answer."""
    return Why(int(np.asarray(why))).name.lower()
