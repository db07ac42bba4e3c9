"""How messages that cross a radio whole and often are packed: deflated, and where one may be lost, again beside the next.

JSON names every member in every message. Both ends know the names from the message's type, and begin with them (deflate's
preset dictionary), so that hardly more than the numbers is left: a third of the bytes. What was packed for another type,
or not at all, does not unpack.
"""

import zlib
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from schemas.message import TICK, Part
from schemas.topics import TOPICS, Stance, Topic
from services.runtime.bus import MAX_PAYLOAD_bytes

BETWEEN = b"\n"
"""Stands between two messages: JSON in one line has none."""
_REMEMBERED = 16
_WINDOW_bits, _MEMORY, _LEVEL = 12, 5, 6  # 4 kB hold two messages and their names; 10 us to pack, 3 to unpack


def packer(topic: Topic[Any]) -> Callable[[bytes], bytes]:
    """Packs one message after the other; one that goes twice goes along with the next too.

    So it is lost only if two packets in a row are, for a third of its bytes more: two that are alike pack well together.
    """
    names, before = _names(topic), list[bytes]()

    def pack(payload: bytes) -> bytes:
        deflate = zlib.compressobj(_LEVEL, zlib.DEFLATED, _WINDOW_bits, _MEMORY, zdict=names)
        packed = deflate.compress(BETWEEN.join((*before, payload))) + deflate.flush()
        before[:] = [payload] if topic.stance is Stance.TWICE else []
        return packed

    return pack


def unpacker(topic: Topic[Any]) -> Callable[[bytes], list[bytes]]:
    """Gives back what a packet brings that no other has brought before; `b""`, which is no message, for what is not packed."""
    names, recent = _names(topic), deque[bytes](maxlen=_REMEMBERED)

    def unpack(packed: bytes) -> list[bytes]:
        news = [each for each in _inflate(packed, names).split(BETWEEN, 1) if not each or each not in recent]
        if topic.stance is Stance.TWICE:
            recent.extend(news)
        return news

    return unpack


def _inflate(packed: bytes, names: bytes) -> bytes:
    inflate = zlib.decompressobj(_WINDOW_bits, names)
    try:
        payload = inflate.decompress(packed, 2 * MAX_PAYLOAD_bytes)
    except zlib.error:
        return b""
    return payload if inflate.eof else b""


def _names(topic: Topic[Any]) -> bytes:
    """As they follow each other in a message of the topic, with those of what its publisher listens to."""
    inputs = [TICK, *(each.key for each in TOPICS if topic.publisher in each.subscribers)]
    return ",".join((*(f'"{key}":' for key in inputs), *_members(topic.type))).encode()


def _members(part: type[Part]) -> Iterator[str]:
    for name, field in part.model_fields.items():
        kind = field.annotation
        nested = _members(kind) if isinstance(kind, type) and issubclass(kind, Part) else ()
        yield f'"{name}":' + (f"{{{','.join(nested)}}}" if nested else "")
