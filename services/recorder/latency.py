"""How long a hand's motion takes to reach the autopilot, read off the provenance of what was said."""

import numpy as np

from schemas.message import Message
from schemas.topics import GUIDANCE, HANDLE_STATE, MOCAP_FRAME, MOCAP_SEEN, SETPOINT, Topic
from services.recorder.reading import Session
from services.recorder.table import Array

CHAIN: tuple[Topic[Message], ...] = (MOCAP_FRAME, HANDLE_STATE, GUIDANCE, SETPOINT)
"""From the capture of the hand to the set-point; each message names the seq of the one before that it contains."""


def reactions(session: Session) -> dict[str, Array]:
    """Delays in s, (N,) each, for every handle sample that reached a set-point, over the first set-point it reached.

    One entry per stage, `tracker -> guiding_controller` and so on, named by who publishes, and `total`. A stage whose
    earlier topic was not recorded is left out. The first delay begins with the capture; each ends, and the next begins,
    with the turn in which the service said its message.
    """
    chain = [topic for topic in CHAIN if len(session.table(topic)["t_s"])]
    if len(session.table(MOCAP_SEEN)["t_s"]):
        chain = [MOCAP_SEEN, *(topic for topic in chain if topic is not MOCAP_FRAME)]
    if HANDLE_STATE not in chain or chain[-1] is not SETPOINT:
        return {}
    times = _first_reached(chain, session)
    stages = {
        f"{_source(a)} -> {b.publisher}": later - earlier
        for a, b, earlier, later in zip(chain, chain[1:], times, times[1:], strict=False)
    }
    return stages | {"total": times[-1] - times[0]}


def _source(topic: Topic[Message]) -> str:
    """Who said it; the tracker writes down what a capture system said."""
    return "capture" if topic is MOCAP_SEEN else topic.publisher


def _first_reached(chain: list[Topic[Message]], session: Session) -> list[Array]:
    """When each message of the chain was said, from the source on, one row per handle sample that came through.

    Of the first topic: when its content was true.
    """
    seq, times = session.table(SETPOINT)["seq"], [said_s(session, SETPOINT)]
    row = np.arange(len(seq))
    handle_seq = seq
    for said, used in zip(reversed(chain), reversed(chain[:-1]), strict=False):
        wanted = _used(session, said, used)[row]
        row, found = _rows_with(session.table(used)["seq"], wanted)
        when = session.table(used)["t_s"] if used is chain[0] else said_s(session, used)
        row, times = row[found], [when[row[found]], *(t[found] for t in times)]
        handle_seq = wanted[found] if used is HANDLE_STATE else handle_seq[found]
    _, first = np.unique(handle_seq, return_index=True)
    return [t[first] for t in times]


def said_s(session: Session, topic: Topic[Message]) -> Array:
    """When each message was said, s since the session's start; its stamp, where the recording is too old to tell."""
    table = session.table(topic)
    later_s = np.where(table["said_ns"] > 0, (table["said_ns"] - table["stamp_ns"]) * 1e-9, 0.0)
    return table["t_s"] + later_s


def _used(session: Session, said: Topic[Message], used: Topic[Message]) -> Array:
    """For each message of `said`: the seq of the message of `used` that it contains, 0 where none."""
    table = session.table(said)
    return table.get(f"inputs.{used.key}", np.zeros(len(table["seq"]), np.int64))


def _rows_with(seq: Array, wanted: Array) -> tuple[Array, Array]:
    """Rows of the messages with the wanted seqs, and which of them exist; after a restart, the last with that seq."""
    order = np.argsort(seq, kind="stable")
    place = np.searchsorted(seq[order], wanted, side="right") - 1
    row = order[np.maximum(place, 0)]
    return row, (wanted > 0) & (seq[row] == wanted)
