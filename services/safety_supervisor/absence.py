"""Who was away cannot tell how long others were silent: what they said meanwhile is still on its way.

For a moment after a stall of the supervisor's own loop, ages are told less the time that it did not listen. Stalls that
follow at once add up, but not without an end: a vehicle that is silent in truth would never be found out.
"""

from typing import NamedTuple

CATCH_UP_S = 0.2
"""Until what waited in the kernel has been read; who is silent in truth is found out so much later."""
ROW_S = 0.5
"""From the end of the first of stalls in a row: what the promise to come down blindly (3 s) leaves to its rule (2.5 s)."""


class State(NamedTuple):
    """What is taken off the ages, for how much longer, and how long ago the first of the stalls in this row ended."""

    away_s: float = 0.0
    left_s: float = 0.0
    row_s: float = 0.0


def step(state: State, missed_s: float, dt: float, stall_s: float) -> State:
    """One tick of `dt` s, `missed_s` of it late; later than `stall_s` is a stall.

    A row is over once the loop has listened for CATCH_UP_S without one. After ROW_S nothing is taken off any more, until
    then.
    """
    stalled, listened_s = missed_s > stall_s, state.left_s - dt + missed_s
    if listened_s <= 0.0:
        return State(missed_s, CATCH_UP_S) if stalled else State()
    row_s, away_s = state.row_s + dt, state.away_s + missed_s * stalled
    return State(away_s if row_s <= ROW_S else 0.0, CATCH_UP_S if stalled else listened_s, row_s)
