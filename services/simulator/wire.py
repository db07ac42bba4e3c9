# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
"""MAVLink 2 on the wire, for the simulator's two ends of it: the stand-in's radio and PX4's simulator port.

The dialect is imported by its MAVLink 2 name, so that no environment variable decides about the version.
"""

import struct
from collections.abc import Iterable, Iterator
from typing import Any

from pymavlink.dialects.v20 import development as dialect  # common and CURRENT_MODE
from pymavlink.generator.mavcrc import x25crc

MAGIC = b"\xfd"
HEADER = struct.Struct("<BBBBBBHB")  # what follows the magic byte: length, flags, sequence, sender, message
_CHECKSUM_BYTES = 2


class Wire(dialect.MAVLink):
    """The dialect with a second, quicker way to send."""

    def send_fields(self, message_id: int, *fields: float) -> None:
        """A message without its object, at a third of the cost: for what goes out 250 times a second.

        The fields come in the order of the wire, arrays flat; trailing zeros do not travel.
        """
        kind = dialect.mavlink_map[message_id]
        payload = kind.unpacker.pack(*fields).rstrip(b"\0") or b"\0"
        low, high = message_id & 0xFFFF, message_id >> 16
        packet = HEADER.pack(len(payload), 0, 0, self.seq, self.srcSystem, self.srcComponent, low, high) + payload
        crc = x25crc(packet + bytes((kind.crc_extra,))).crc
        self.file.write(MAGIC + packet + crc.to_bytes(2, "little"))
        self.seq = (self.seq + 1) % 256


def take_frame(stream: bytearray) -> tuple[int, bytes] | None:
    """The first whole message of a reliable stream, taken off it: its id and payload; None where there is none yet.

    Raises ValueError where the stream does not begin with a MAVLink 2 message.
    """
    if len(stream) <= HEADER.size:
        return None
    if not stream.startswith(MAGIC):
        raise ValueError("not MAVLink 2")
    length, *_, low, high = HEADER.unpack_from(stream, 1)
    begin = 1 + HEADER.size
    end = begin + length + _CHECKSUM_BYTES
    if len(stream) < end:
        return None
    payload = bytes(stream[begin : begin + length])
    del stream[:end]
    return low | high << 16, payload


def frames(datagram: bytes) -> Iterator[tuple[int, int, bytes]]:
    """The whole MAVLink 2 messages of a datagram, unsigned: number, the sender's component, and the bytes of each."""
    at = 0
    while datagram[at : at + 1] == MAGIC:
        length, _, _, _, _, component, low, high = HEADER.unpack_from(datagram, at + 1)
        end = at + 1 + HEADER.size + length + _CHECKSUM_BYTES
        yield low | high << 16, component, datagram[at:end]
        at = end


def numbers(names: Iterable[str]) -> frozenset[int]:
    """Of the messages of these names."""
    wanted = frozenset(names)
    return frozenset(number for number, kind in dialect.mavlink_map.items() if kind.msgname in wanted)


def unpack(message_id: int, payload: bytes) -> Any:
    """The fields in the order of the wire, arrays flat; trailing zeros have not travelled."""
    kind = dialect.mavlink_map[message_id]
    return kind.unpacker.unpack(payload.ljust(kind.unpacker.size, b"\0")[: kind.unpacker.size])
