"""A bus inside one process: simulation faster than real time, and tests with faults."""

import asyncio
from collections import defaultdict, deque
from collections.abc import Mapping

from schemas.topics import Stance
from services.runtime.bus import DEPTH, Mailbox, MAX_PAYLOAD_bytes, OnPayload


class MemoryBus:
    """Delivers each put after a fixed latency, in order for each key; deterministic on a virtual loop.

    Faults are plain data that a test may change at any time: `latency_s[key]` delays a key, a key in `cut` is lost.
    """

    def __init__(self, latency_s: Mapping[str, float] | None = None) -> None:
        self.latency_s = dict(latency_s or {})
        self.cut: set[str] = set()
        self._subscribers: defaultdict[str, list[OnPayload]] = defaultdict(list)
        self._in_flight: defaultdict[str, deque[bytes]] = defaultdict(deque)

    def put(self, key: str, payload: bytes, stance: Stance) -> None:
        """Deliver later, never within the call; a payload too large arrives as `b""`."""
        if key in self.cut:
            return
        self._in_flight[key].append(payload if len(payload) <= MAX_PAYLOAD_bytes else b"")
        asyncio.get_running_loop().call_later(self.latency_s.get(key, 0.0), self._deliver, key)

    def subscribe(self, key: str, on_payload: OnPayload) -> None:
        """Exact keys only; subscribers are called in the order of their subscription."""
        self._subscribers[key].append(on_payload)

    def mailbox(self, key: str) -> Mailbox:
        """As Bus.mailbox."""
        waiting: deque[tuple[str, bytes]] = deque(maxlen=DEPTH)
        self.subscribe(key, lambda key, payload: waiting.append((key, payload)))

        def take() -> list[tuple[str, bytes]]:
            taken = list(waiting)
            waiting.clear()
            return taken

        return take

    def _deliver(self, key: str) -> None:
        payload = self._in_flight[key].popleft()  # the oldest, whichever timer fired: a link does not reorder
        for on_payload in self._subscribers[key]:
            on_payload(key, payload)
