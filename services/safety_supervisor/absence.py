"""Who was away cannot tell how long others were silent: what they said meanwhile is still on its way.

For a moment after a stall of the supervisor's own loop, ages are told less the time that it did not listen.
"""

from typing import NamedTuple

CATCH_UP_S = 0.2
"""Until what waited in the kernel has been read; who is silent in truth is found out so much later."""


class State(NamedTuple):
    """What is taken off the ages, and for how much longer."""

    away_s: float = 0.0
    left_s: float = 0.0


def step(state: State, missed_s: float, dt: float, stall_s: float) -> State:
    """One tick of `dt` s, `missed_s` of it late; later than `stall_s` is a stall. Stalls that follow at once add up."""
    left_s = state.left_s - dt + missed_s
    before_s = state.away_s if left_s > 0.0 else 0.0
    if missed_s > stall_s:
        return State(before_s + missed_s, CATCH_UP_S)
    return State(before_s, max(left_s, 0.0))
