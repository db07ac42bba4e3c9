"""A service that can be made to stand still, as SIGSTOP does: its loops wait wherever they are, and find the rest later."""

import asyncio
from collections.abc import AsyncIterator
from typing import TypeVar

from schemas.message import Message
from schemas.topics import Topic
from services.runtime.bus import Bus
from services.runtime.clock import Clock
from services.runtime.node import Node
from services.runtime.readers import Stream
from services.runtime.ticker import Tick

M = TypeVar("M", bound=Message)


class StoppableNode(Node):
    """A node whose loops go on only while `going` is set."""

    def __init__(self, name: str, bus: Bus, clock: Clock) -> None:
        super().__init__(name, bus, clock)
        self.going = asyncio.Event()
        self.going.set()

    def ticks(self, rate_Hz: float) -> AsyncIterator[Tick]:
        """As Node.ticks."""
        return self._held_up(super().ticks(rate_Hz))

    def stream(self, topic: Topic[M], depth: int = 64) -> Stream[M]:
        """As Node.stream."""
        stream = StoppableStream(self._inbox(topic), depth, self._heart)
        stream.going = self.going
        return stream

    async def _held_up(self, ticks: AsyncIterator[Tick]) -> AsyncIterator[Tick]:
        async for tick in ticks:
            await self.going.wait()
            yield tick


class StoppableStream(Stream[M]):
    """A stream whose reader goes on only while `going` is set."""

    going: asyncio.Event

    async def __anext__(self) -> M:
        """The next message, or the same one later."""
        await self.going.wait()
        message = await super().__anext__()
        await self.going.wait()
        return message
