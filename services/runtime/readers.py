"""How a service reads a topic: the newest message (Latest), or each in order, looked up (Queue) or waited for (Stream).

Only a Stream wakes its loop when something arrives. The others look when they are asked, and what they show stays the
same until the loop's next turn, so that a law and the `inputs` of its message speak of the same samples.
"""

import asyncio
from collections import deque
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar

from schemas.message import Message
from schemas.topics import Topic
from services.runtime.inbox import Inbox

if TYPE_CHECKING:
    from services.runtime.heart import Heart

M = TypeVar("M", bound=Message)


class Latest(Generic[M]):
    """The newest message of a topic, valid or not."""

    def __init__(self, inbox: Inbox[M]) -> None:
        self.topic: Topic[M] = inbox.topic
        self._inbox = inbox
        self._clock = inbox.clock
        self._timeout_ns = inbox.topic.timeout_s * 1e9 + inbox.hosts.allowance_ns(inbox.topic.publisher)
        inbox.listen()

    @property
    def message(self) -> M | None:
        """What arrived last; None before the first."""
        self._inbox.look()
        return self._inbox.message

    @property
    def received_ns(self) -> int:
        """When it was first seen here, on the own clock; 0 before the first."""
        self._inbox.look()
        return self._inbox.received_ns

    @property
    def fresh(self) -> bool:
        """A valid message whose reception and whose content are younger than the topic's timeout.

        Stamps of the other host are on this host's clock (hosts.py), or the message is not fresh. A stamp that lies ahead
        by more than the timeout is not trusted.
        """
        message = self.message
        if message is None or not message.valid or not self._inbox.dated:
            return False
        now_ns = self._clock.now_ns()
        return now_ns - self._inbox.received_ns < self._timeout_ns and abs(now_ns - message.stamp_ns) < self._timeout_ns

    @property
    def value(self) -> M | None:
        """The message if it is fresh, else None."""
        return self.message if self.fresh else None

    @property
    def age_s(self) -> float:
        """Of the content: now - stamp; infinite before the first message, and while clocks have not been compared."""
        message = self.message
        known = message is not None and self._inbox.dated
        return (self._clock.now_ns() - message.stamp_ns) * 1e-9 if message and known else float("inf")


class Queue(Latest[M]):
    """Every message of a topic, in order, for one consumer that looks by itself. When it lags, the oldest are dropped.

    `message` is the last one taken out, so that `used` names what was consumed, not what lies waiting.
    """

    def __init__(self, inbox: Inbox[M], depth: int) -> None:
        super().__init__(inbox)
        self.overflowed = 0
        self._queue: deque[M] = deque(maxlen=depth)
        self._taken: M | None = None
        inbox.taps.append(self._push)

    @property
    def message(self) -> M | None:
        """The last one taken out; None before the first."""
        return self._taken

    def drain(self) -> list[M]:
        """All that arrived since the last call, oldest first."""
        self._inbox.look()
        drained = list(self._queue)
        self._queue.clear()
        if drained:
            self._taken = drained[-1]
        return drained

    def _push(self, message: M) -> None:
        if len(self._queue) == self._queue.maxlen:
            self.overflowed += 1
            self._inbox.reject(self.topic.key, "its reader lags: the oldest message was dropped")
        self._queue.append(message)


class Stream(Queue[M]):
    """A queue that can be waited for: `async for message in stream`."""

    def __init__(self, inbox: Inbox[M], depth: int, heart: "Heart") -> None:
        inbox.wake()
        super().__init__(inbox, depth)
        self._heart = heart
        self._waiter: asyncio.Future[None] | None = None
        heart.sleepers.append(self._wake)

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> M:
        while not self._queue:
            self._heart.beat()
            self._heart.wake_later()
            self._waiter = asyncio.get_running_loop().create_future()
            await self._waiter
        self._heart.turn()
        self._taken = self._queue.popleft()
        return self._taken

    def _push(self, message: M) -> None:
        super()._push(message)
        self._wake()

    def _wake(self) -> None:
        if self._waiter and not self._waiter.done():
            self._waiter.set_result(None)


def used(*readers: Latest[Any]) -> dict[str, int]:
    """The seq of the message that each reader holds, by topic: what goes into a message's `inputs`."""
    return {reader.topic.key: reader.message.seq for reader in readers if reader.message}
