"""Whether the hand is where motion capture sees the handle: a taut cable leads to it, and says so from the other end.

A capture system that takes something else for the handle shows it calmly, for as long as the mistake lasts. The filter keeps
the jump out for `lost_s`, but then has to begin anew somewhere. Where the vehicle is and which way the cable pulls it is known
without the handle's markers. So a handle that is seen for `lost_s` where a taut cable does not lead is not believed any more,
whether it jumped there or crept; nor is the cable's end then, because either may be wrong. How far the cable leads is known
better than which way: a hand that lifts the handle slackens it, so one that is seen coming near on a taut cable is none, and
counts double. It would push the vehicle up against the hand that holds. But once a hand is near enough to push, the vehicle
gives way, and then the estimate errs by as much as a cable pulls: what it says there counts for nothing. A slack cable says
nothing either: what is in doubt stays so until the cable is taut and leads there again, or the vehicle has landed.

| paper | here | unit | frame |
|---|---|---|---|
| p_H as seen | z | m | W |
| p_H = p_R - f_c (1/k_c + l̄/‖f_c‖), last remark | Led.p_H | m | W |
| f_c/‖f_c‖ | Led.along | | W |
"""

from typing import NamedTuple

from services.physics import Array, dot, norm
from services.tracker import filtering
from services.tracker.filtering import Filter, Output

TAUT_N = 0.7  # less is a slack cable too, by what the estimate errs while the vehicle turns
APART_M = 0.3  # six times what both ends of a taut cable differ by in a walk
SHORT_M, LONG_M = (
    0.05,
    0.1,
)  # along it; while a cable goes slack the estimate lags for 0.05 s, a third of what is needed


class Led(NamedTuple):
    """Where a taut cable leads, (3,) m, and the unit vector (3,) along it, to the vehicle.

    To a hand that is seen more than `yields_m` nearer than that the vehicle gives way.
    """

    p_H: Array
    along: Array
    yields_m: float


class State(NamedTuple):
    """The filter; how much longer the handle has lately been seen elsewhere than at the cable's end, s; is it in doubt?"""

    motion: filtering.State
    apart_s: float
    doubted: bool


def start() -> State:
    """Nothing seen, nothing in doubt."""
    return State(filtering.start(), 0.0, doubted=False)


def step(
    state: State, z: Array, measured: bool, led: Led | None, aloft: bool, dt: float, p: Filter
) -> tuple[State, Output]:
    """One frame, `dt` s after the last; nothing is valid while the handle is in doubt.

    `led` is None where the cable is slack or not known. On the ground there is no doubt.
    """
    apart_s, doubted = _doubt(state, z, led if measured else None, dt, p) if aloft else (0.0, False)
    motion, found = filtering.step(state.motion, z, measured, dt, p, follows=not doubted, may_restart=not doubted)
    return State(motion, apart_s, doubted), found._replace(valid=found.valid and not doubted)


def _doubt(state: State, z: Array, led: Led | None, dt: float, p: Filter) -> tuple[float, bool]:
    """In doubt once both have been apart for `lost_s`, until they have been together for as long again."""
    counts = 0.0 if led is None else _counts(z, led)
    apart_s = min(max(state.apart_s + counts * dt, 0.0), 2.0 * p.lost_s)
    return apart_s, apart_s > p.lost_s or (state.doubted and apart_s > 0.0)


def _counts(z: Array, led: Led) -> float:
    """What a moment counts for the doubt, or against it where the handle is seen where the cable leads."""
    away = z - led.p_H
    short_m = float(dot(away, led.along))
    if float(norm(away)) > APART_M:
        return 1.0
    if short_m > led.yields_m:
        return 0.0
    return 2.0 if short_m > SHORT_M or short_m < -LONG_M else -1.0
