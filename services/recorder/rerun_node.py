"""What a service runs on when its recorded turns are repeated: a bus and a node that hand over what they are told to."""

import asyncio
from collections import defaultdict
from collections.abc import AsyncIterator, Sequence
from typing import TypeVar

from schemas.message import Message
from schemas.topics import Stance, Topic
from services.runtime.bus import Mailbox, OnPayload
from services.runtime.hosts import Placement
from services.runtime.inbox import Inbox
from services.runtime.node import Node, Tick
from services.runtime.readers import Queue
from services.runtime.virtual import VirtualClock

M = TypeVar("M", bound=Message)


class RecordedBus:
    """A Bus on which nobody else speaks: `deliver` puts in, `said` holds what came out."""

    def __init__(self) -> None:
        self.said: list[tuple[str, bytes]] = []
        self.awaited: dict[str, OnPayload] = {}
        """Topics whose arrival wakes the service."""
        self._waiting: defaultdict[str, list[tuple[str, bytes]]] = defaultdict(list)

    def put(self, key: str, payload: bytes, stance: Stance) -> None:
        """Kept."""
        self.said.append((key, payload))

    def subscribe(self, key: str, on_payload: OnPayload) -> None:
        """One reader for each topic, as an inbox is."""
        self.awaited[key] = on_payload

    def mailbox(self, key: str) -> Mailbox:
        """What has been delivered since the last look."""

        def take() -> list[tuple[str, bytes]]:
            taken, self._waiting[key] = self._waiting[key], []
            return taken

        return take

    def deliver(self, key: str, payloads: Sequence[bytes]) -> None:
        """In order; a topic that is awaited wakes the service."""
        for payload in payloads:
            if key in self.awaited:
                self.awaited[key](key, payload)
            else:
                self._waiting[key].append((key, payload))


class RerunNode(Node):
    """A node on virtual time that ticks when it is told to. It may read every topic: the recording was made by the table."""

    def __init__(self, name: str, bus: RecordedBus, placement: Placement) -> None:
        super().__init__(name, bus, VirtualClock(), observer=True, placement=placement)
        self.queued: set[str] = set()
        """Topics of which every message counts, not the newest alone."""
        self._due: asyncio.Queue[tuple[int, int]] = asyncio.Queue()

    def queue(self, topic: Topic[M], depth: int = 64) -> Queue[M]:
        """As Node.queue."""
        self.queued.add(topic.key)
        return super().queue(topic, depth)

    def tick(self, n: int, missed: int) -> None:
        """Let the loop turn once."""
        self._due.put_nowait((n, missed))

    async def ticks(self, rate_Hz: float) -> AsyncIterator[Tick]:
        """One for each call of `tick`; stamps are as far apart as they were, from the first turn's clock on."""
        period_ns, stamp_ns, last = round(1e9 / rate_Hz), 0, 0
        while True:
            n, missed = await self._due.get()
            stamp_ns = stamp_ns + (n - last + missed) * period_ns if stamp_ns else self.turn.now_ns()
            last = n
            yield Tick(n, (1 + missed) / rate_Hz, missed, stamp_ns)

    def _inbox(self, topic: Topic[M]) -> Inbox[M]:
        """What a recording names was taken: no command is refused for its age once more."""
        inbox = super()._inbox(topic)
        inbox.obeys = False
        return inbox
