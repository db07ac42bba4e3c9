"""What carries messages between services: three methods, bytes only. The typed layer over it is node.py."""

from collections.abc import Callable
from typing import Protocol

from schemas.topics import Stance

MAX_PAYLOAD_bytes = 65_536

OnPayload = Callable[[str, bytes], None]
"""Called with the key that a sample was put on and its bytes."""

Mailbox = Callable[[], list[tuple[str, bytes]]]
"""What has arrived since the last call, oldest first: keys and bytes as for OnPayload."""

DEPTH = 1024
"""Samples of one key that wait for a loop that is late; then the oldest are dropped."""


class Bus(Protocol):
    """Keys are those of the table; a bus adds its own prefix to them."""

    def put(self, key: str, payload: bytes, stance: Stance) -> None:
        """Send and forget: never blocks, never raises because nobody listens."""
        ...

    def subscribe(self, key: str, on_payload: OnPayload) -> None:
        """Call `on_payload` in the event loop's thread for each sample, in the order of one publisher's puts.

        What is not a put of at most MAX_PAYLOAD_bytes (a DELETE, a monster) arrives as `b""`, which is no message.
        """
        ...

    def mailbox(self, key: str) -> Mailbox:
        """Keep the samples of `key` until they are asked for, at most DEPTH; wakes nobody."""
        ...
