"""A capture system's own time stamps on this host's clock. Pure.

All that is known of the two clocks is when each frame arrived. The fastest frame so far bounds their difference: with d its
unknown delay, arrival = source + difference + d. The difference is kept at the smallest `arrival - source`, which may grow
by what clocks drift. So a stamp is late by the shortest way that a frame ever took, and free of the network's jitter.
"""

from typing import NamedTuple

DRIFT_PER_S = 1e-4
NEW_CLOCK_NS = 1_000_000_000
"""A frame this much later than the fastest ones tells that the system began to count anew."""


class State(NamedTuple):
    """Smallest arrival - source, and the last frame's stamps on either clock; None before the first frame."""

    lead_ns: int | None = None
    source_ns: int = 0
    stamp_ns: int = 0


def step(state: State, source_ns: int, arrival_ns: int) -> State:
    """One frame; its stamp is the new state's `stamp_ns`: never after its arrival, never before the last."""
    lead_ns = arrival_ns - source_ns
    if state.lead_ns is not None and source_ns > state.source_ns and lead_ns - state.lead_ns < NEW_CLOCK_NS:
        lead_ns = min(lead_ns, state.lead_ns + round(DRIFT_PER_S * (source_ns - state.source_ns)))
    return State(lead_ns, source_ns, max(source_ns + lead_ns, state.stamp_ns))
