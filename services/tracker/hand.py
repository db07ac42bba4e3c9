"""Whether the hand is where motion capture sees the handle: a taut cable leads to it, and says so from the other end.

A capture system that takes something else for the handle shows it calmly, for as long as the mistake lasts. The filter keeps
the jump out for `lost_s`, but then has to begin anew somewhere. Where the vehicle is and which way the cable pulls it is known
without the handle's markers. So a handle that is seen for `lost_s` where a taut cable does not lead is not believed any more,
whether it jumped there or crept; nor is the cable's end then, because either may be wrong. A slack cable says nothing: what
is in doubt stays so until the cable is taut and leads there again, or the vehicle has landed.

| paper | here | unit | frame |
|---|---|---|---|
| p_H as seen | z | m | W |
| p_H = p_R - f_c (1/k_c + l̄/‖f_c‖), last remark | led | m | W |
"""

from typing import NamedTuple

from services.physics import Array, norm
from services.tracker import filtering
from services.tracker.filtering import Filter, Output

TAUT_N = 0.7  # less is a slack cable too, by what the estimate errs while the vehicle turns
APART_M = 0.3  # six times what both ends of a taut cable differ by in a walk


class State(NamedTuple):
    """The filter; how much longer the handle has lately been seen elsewhere than at the cable's end, s; is it in doubt?"""

    motion: filtering.State
    apart_s: float
    doubted: bool


def start() -> State:
    """Nothing seen, nothing in doubt."""
    return State(filtering.start(), 0.0, doubted=False)


def step(
    state: State, z: Array, measured: bool, led: Array | None, aloft: bool, dt: float, p: Filter
) -> tuple[State, Output]:
    """One frame, `dt` s after the last; nothing is valid while the handle is in doubt.

    `led` is where a taut cable leads, (3,) m, None where it is slack or not known. On the ground there is no doubt.
    """
    apart_s, doubted = _doubt(state, z, led if measured else None, dt, p) if aloft else (0.0, False)
    motion, found = filtering.step(state.motion, z, measured, dt, p, follows=not doubted, may_restart=not doubted)
    return State(motion, apart_s, doubted), found._replace(valid=found.valid and not doubted)


def _doubt(state: State, z: Array, led: Array | None, dt: float, p: Filter) -> tuple[float, bool]:
    """In doubt once both have been apart for `lost_s`, until they have been together for as long again."""
    if led is None:
        return state.apart_s, state.doubted
    apart = float(norm(z - led)) > APART_M
    apart_s = min(max(state.apart_s + (dt if apart else -dt), 0.0), 2.0 * p.lost_s)
    return apart_s, apart_s > p.lost_s or (state.doubted and apart_s > 0.0)
