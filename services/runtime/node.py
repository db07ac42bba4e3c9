"""The typed layer over a bus, one for each service: topics in, messages out, ticks, and health on the side."""

import logging
from collections import Counter
from collections.abc import AsyncIterator
from typing import Any, Generic, TypeVar

from schemas.message import Message
from schemas.topics import HEALTH, RADIO_CLOCK, Topic
from services.runtime.bus import Bus
from services.runtime.clock import Clock
from services.runtime.heart import Heart, Report
from services.runtime.hosts import Hosts, Placement
from services.runtime.inbox import Inbox
from services.runtime.readers import Arrivals, Latest, Queue, Stream, used
from services.runtime.ticker import LoopStats, Tick, ticks
from services.runtime.turn import Turn

__all__ = ["Latest", "Node", "Publisher", "Queue", "Stream", "Tick", "used"]

M = TypeVar("M", bound=Message)


class Publisher(Generic[M]):
    """The one writer of a topic. It sends what it is given, once: no repeat, no cache."""

    def __init__(self, topic: Topic[M], bus: Bus, turn: Turn) -> None:
        self.topic = topic
        self.seq = 0
        """Of the last message; the next has one more."""
        self._bus = bus
        self._turn = turn

    def publish(self, message: M) -> M:
        """Send `message` under the next seq, stamped with this turn where it has no stamp; returns what was sent."""
        self.seq += 1
        now_ns = self._turn.now_ns()
        header = {"seq": self.seq, "stamp_ns": message.stamp_ns or now_ns, "said_ns": now_ns}
        stamped = message.model_copy(update=header)
        self._bus.put(self.topic.key, stamped.__pydantic_serializer__.to_json(stamped), self.topic.stance)
        return stamped


class Node:
    """What a service holds. It may write and read what the table says; an `observer` may read everything."""

    def __init__(
        self, name: str, bus: Bus, clock: Clock, *, observer: bool = False, placement: Placement | None = None
    ) -> None:
        self.name = name
        self.clock = clock
        """The host's time; laws and stamps go by the `turn`'s."""
        self.turn = Turn(clock)
        self.status = ""
        self.host_status = ""
        self.rejected: Counter[str] = Counter()
        self.bus = bus
        """As it came: for who wants a topic's bytes, not its messages."""
        self._observer = observer
        self._inboxes: dict[str, Inbox[Any]] = {}
        self._publishers: dict[str, Publisher[Any]] = {}
        self._report = Report(name, self.turn)
        self._heart = Heart(self.turn, self._publish_health if name in HEALTH else None)
        self.hosts = Hosts(placement)
        if self.hosts.two and name != RADIO_CLOCK.publisher:
            self._compare_clocks()

    def publisher(self, topic: Topic[M]) -> Publisher[M]:
        """The writer of `topic`.

        Raises:
            ValueError: the table names another publisher.
        """
        if topic.publisher != self.name:
            raise ValueError(f"{self.name} may not publish {topic.key}: the table names {topic.publisher}")
        return self._publishers.setdefault(topic.key, Publisher(topic, self.bus, self.turn))

    def latest(self, topic: Topic[M]) -> Latest[M]:
        """A reader of the newest message.

        Raises:
            ValueError: the table does not list this service as a subscriber.
        """
        return Latest(self._inbox(topic))

    def queue(self, topic: Topic[M], depth: int = 64) -> Queue[M]:
        """A reader of every message that is looked into, not waited for; at most `depth` wait. Raises as `latest`."""
        return Queue(self._inbox(topic), depth)

    def stream(self, topic: Topic[M], depth: int = 64) -> Stream[M]:
        """A reader of every message; at most `depth` wait. Raises as `latest`."""
        return Stream(self._inbox(topic), depth, self._heart)

    def arrivals(self, depth: int = 64) -> Arrivals[Any]:
        """A way into this service's loop for a device that is not on the bus; at most `depth` messages wait."""
        return Arrivals(depth, self._heart)

    def ticks(self, rate_Hz: float) -> AsyncIterator[Tick]:
        """The service's loop: `async for tick in node.ticks(100.0)`."""
        return ticks(rate_Hz, self._heart.stats, self._heart.beat)

    def reject(self, topic_key: str, why: str) -> None:
        """Count input that is not acted upon; the first of each topic is logged."""
        self.rejected[topic_key] += 1
        if self.rejected[topic_key] == 1:
            logging.getLogger(self.name).warning("rejected %s: %s", topic_key, why[:300])

    @property
    def stats(self) -> LoopStats:
        """How punctual the loop has been: `stats.stalls`, `stats.missed`, ..."""
        return self._heart.stats

    @property
    def received(self) -> dict[str, int]:
        """Accepted messages by topic."""
        for inbox in self._inboxes.values():
            inbox.look()
        return {key: inbox.received for key, inbox in self._inboxes.items()}

    @property
    def restarts(self) -> dict[str, int]:
        """How often the publisher of a topic began anew."""
        return {key: inbox.restarts for key, inbox in self._inboxes.items()}

    def _inbox(self, topic: Topic[M]) -> Inbox[M]:
        if not (self._observer or self.name in topic.subscribers):
            raise ValueError(f"{self.name} may not read {topic.key}: the table lists {', '.join(topic.subscribers)}")
        if topic.key not in self._inboxes:
            self._inboxes[topic.key] = Inbox(topic, self.bus, self.turn, self.reject, self.hosts)
            self._inboxes[topic.key].obeys = self.name in topic.subscribers
        return self._inboxes[topic.key]

    def _compare_clocks(self) -> None:
        """Let `hosts` know each comparison before a message of the other host is dated."""
        inbox = self._inbox(RADIO_CLOCK)
        inbox.taps.append(self.hosts.note)
        inbox.listen()
        self.hosts.look = inbox.look

    def _publish_health(self) -> None:
        for inbox in self._inboxes.values():
            inbox.look()
        status = " ".join(filter(None, (self.status, self.host_status)))
        health = self._report.heartbeat(self.stats, self.received, self.rejected, status)
        self.publisher(HEALTH[self.name]).publish(health)
