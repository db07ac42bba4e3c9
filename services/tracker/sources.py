"""Where frames of motion capture come from. A source is an async iterator of frames; it neither filters nor judges."""

from collections.abc import AsyncIterator
from typing import Protocol

from schemas.topics import MOCAP_FRAME
from schemas.tracking import MocapFrame
from services.runtime.node import Node


class Source(Protocol):
    """Frames as they come; `seq` is 0 for a source that is not on the bus."""

    def __aiter__(self) -> AsyncIterator[MocapFrame]: ...


def open_source(kind: str, node: Node) -> Source:
    """The source of that kind.

    Raises:
        ValueError: for a kind that does not exist, with those that do.
    """
    if kind == "simulated":
        return node.stream(MOCAP_FRAME)
    raise ValueError(f"tracker.source = {kind!r}: must be simulated")
