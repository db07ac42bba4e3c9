"""Where frames of motion capture come from. A source is an async iterator of frames; it neither filters nor judges."""

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import NamedTuple, Protocol

from schemas.topics import MOCAP_FRAME, MOCAP_SEEN, Topic
from schemas.tracking import MocapFrame
from services.runtime.node import Node
from services.sections import Tracker
from services.tracker.bodies import SIMULATED
from services.tracker.capture import Capture


class Frames(Protocol):
    """Frames as they come; `seq` is 0 for one that is not on the bus yet."""

    def __aiter__(self) -> "Frames": ...
    async def __anext__(self) -> MocapFrame: ...


class Source(NamedTuple):
    """Frames, the topic under which they are on the bus, and what keeps frames or bodies away, in words."""

    frames: Frames
    topic: Topic[MocapFrame]
    trouble: Callable[[], str] = lambda: ""


def recorded(p: Tracker, node: Node) -> Source:
    """What was or is on the bus: simulated frames, or those that a tracker took from a capture system."""
    topic = MOCAP_FRAME if p.source == SIMULATED else MOCAP_SEEN
    return Source(node.stream(topic), topic)


@asynccontextmanager
async def open_source(p: Tracker, node: Node) -> AsyncGenerator[Source]:
    """The profile's source, while it is open."""
    if p.source == SIMULATED or p.mocap is None:
        yield recorded(p, node)
        return
    capture, arrivals = Capture(p.source, p.mocap, node.clock), node.arrivals()

    def tell(trouble: str) -> None:
        node.status = trouble

    async with asyncio.TaskGroup() as group:
        following = group.create_task(capture.follow(arrivals.put, tell))
        yield Source(arrivals, MOCAP_SEEN, lambda: capture.trouble)
        following.cancel()
