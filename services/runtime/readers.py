"""How a service reads a topic: the newest message (Latest), or each in order, looked up (Queue) or waited for (Stream).

Only a Stream wakes its loop when something arrives. The others look when they are asked, and what they show stays the
same until the loop's next turn, so that a law and the `inputs` of its message speak of the same samples. What the other
host said is stamped with this host's clock, by the comparison of the clocks (hosts.py) that the turn began with: it is
among the `inputs` too.
"""

import asyncio
from collections import deque
from collections.abc import Sized
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar

from schemas.message import MISSED, TICK, Message
from schemas.topics import Topic
from services.runtime.inbox import Inbox
from services.runtime.ticker import Tick

if TYPE_CHECKING:
    from services.runtime.heart import Heart

M = TypeVar("M", bound=Message)


class Latest(Generic[M]):
    """The newest message of a topic, valid or not."""

    def __init__(self, inbox: Inbox[M]) -> None:
        self.topic: Topic[M] = inbox.topic
        self._inbox = inbox
        self._turn = inbox.turn
        self._crosses = inbox.hosts.crosses(inbox.topic.publisher)
        self._timeout_ns = inbox.topic.timeout_s * 1e9 + inbox.hosts.allowance_ns(inbox.topic.publisher)
        inbox.listen()

    @property
    def message(self) -> M | None:
        """What arrived last; None before the first."""
        held = self._held()
        return self._inbox.hosts.here(self.topic.publisher, held) if held and self._crosses else held

    @property
    def received_ns(self) -> int:
        """The turn in which it was first seen here, on the own clock; 0 before the first."""
        self._inbox.look()
        return self._inbox.received_ns

    @property
    def fresh(self) -> bool:
        """A valid message whose reception and whose content are younger than the topic's timeout.

        While the clocks of the hosts have not been compared, nothing of the other is. A stamp that lies ahead by more than
        the timeout is not trusted.
        """
        held, here_ns = self._held(), self._here_ns()
        if held is None or not held.valid or here_ns is None:
            return False
        now_ns = self._turn.now_ns()
        return now_ns - self._inbox.received_ns < self._timeout_ns and abs(now_ns - here_ns) < self._timeout_ns

    @property
    def value(self) -> M | None:
        """The message if it is fresh, else None."""
        return self.message if self.fresh else None

    @property
    def age_s(self) -> float:
        """Of the content: now - stamp, 0 for what was said since the turn began; infinite where it has none that is known."""
        here_ns = self._here_ns()
        return float("inf") if here_ns is None else max(self._turn.now_ns() - here_ns, 0) * 1e-9

    @property
    def comparison(self) -> dict[str, int]:
        """The comparison of the clocks that dates what is read here, for `inputs`; empty where none does."""
        return self._inbox.hosts.inputs(self.topic.publisher)

    def _held(self) -> M | None:
        """As it was said."""
        self._inbox.look()
        return self._inbox.message

    def _here_ns(self) -> int | None:
        """Its stamp on this host's clock; None where there is no message or no comparison."""
        held = self._held()
        if held is None or not self._crosses:
            return held and held.stamp_ns
        return self._inbox.hosts.here_ns(self.topic.publisher, held.stamp_ns)


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

    def drain(self) -> list[M]:
        """All that arrived since the last call, oldest first."""
        self._inbox.look()
        drained = list(self._queue)
        self._queue.clear()
        if drained:
            self._taken = drained[-1]
        return [self._inbox.hosts.here(self.topic.publisher, message) for message in drained]

    def _held(self) -> M | None:
        return self._taken

    def _push(self, message: M) -> None:
        if len(self._queue) == self._queue.maxlen:
            self.overflowed += 1
            self._inbox.reject(self.topic.key, "its reader lags: the oldest message was dropped")
        self._queue.append(message)


class _Bell:
    """Wakes a loop that waits for something to arrive; the heart goes on beating meanwhile."""

    def __init__(self, heart: "Heart") -> None:
        self._heart = heart
        self._waiter: asyncio.Future[None] | None = None
        heart.sleepers.append(self.ring)

    async def until(self, waiting: Sized) -> None:
        """Return when `waiting` is not empty: a turn of the loop begins."""
        while not waiting:
            self._heart.beat()
            self._heart.wake_later()
            self._waiter = asyncio.get_running_loop().create_future()
            await self._waiter
        self._heart.turn()

    def ring(self) -> None:
        """Let whoever waits look again."""
        if self._waiter and not self._waiter.done():
            self._waiter.set_result(None)


class Stream(Queue[M]):
    """A queue that can be waited for: `async for message in stream`."""

    def __init__(self, inbox: Inbox[M], depth: int, heart: "Heart") -> None:
        inbox.wake()
        super().__init__(inbox, depth)
        self._bell = _Bell(heart)

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> M:
        await self._bell.until(self._queue)
        self._taken = self._queue.popleft()
        return self._inbox.hosts.here(self.topic.publisher, self._taken)

    def _push(self, message: M) -> None:
        super()._push(message)
        self._bell.ring()


class Arrivals(Generic[M]):
    """What comes to a loop from a device instead of the bus, in order; when the loop lags, the oldest are dropped."""

    def __init__(self, depth: int, heart: "Heart") -> None:
        self._queue: deque[M] = deque(maxlen=depth)
        self._bell = _Bell(heart)

    def put(self, message: M) -> None:
        """From the loop's own thread."""
        self._queue.append(message)
        self._bell.ring()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> M:
        await self._bell.until(self._queue)
        return self._queue.popleft()


def used(*readers: Latest[Any], tick: Tick | None = None) -> dict[str, int]:
    """What goes into a message's `inputs`: the seq of the message that each reader holds, by topic, and the tick.

    Where a reader holds what the other host said, also the comparison of the clocks that dated it.
    """
    compared = {key: seq for reader in readers for key, seq in reader.comparison.items()}
    inputs = compared | {reader.topic.key: held.seq for reader in readers if (held := reader.message)}
    if tick is not None:
        inputs[TICK] = tick.n + 1
        if tick.missed:
            inputs[MISSED] = tick.missed
    return inputs
