"""The records of an MCAP file, whether it was finished, cut off or damaged. The file is mapped, never copied whole."""

import mmap
from collections.abc import Callable, Collection, Iterator, Mapping
from io import BytesIO
from pathlib import Path
from struct import Struct
from typing import Any, NamedTuple, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, Metadata, Schema
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream
from zstandard import ZstdError

MAGIC = bytes((0x89, *b"MCAP0\r\n"))
_FRAME = Struct("<BQ")  # opcode and length of a record
_MESSAGE = Struct("<HIQQ")  # channel, sequence, log time, publish time
_SPAN = Struct("<QQ")  # of a chunk's messages
_FOREIGN = {b"ULog": "a PX4 log", b"SQLite format": "a ROS 2 bag in SQLite", b"#ROSBAG": "a ROS 1 bag"}

R = TypeVar("R")


class NotARecording(ValueError):
    """Not an MCAP file, or not one of Clew's; the text says what it is, as far as that is known."""


class Heard(NamedTuple):
    """One message as it stands in the file."""

    channel: int
    sequence: int
    log_ns: int
    payload: bytes


class RecordFile:
    """What a file holds. Channels, metadata and attachments are read at once, messages when they are asked for.

    Raises NotARecording where the file is no MCAP file, and OSError where it cannot be read.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.metadata: dict[str, Mapping[str, str]] = {}
        self.attachments: dict[str, bytes] = {}
        self.profile = self.library = ""
        self.finished = False
        self.bytes_left = 0
        """After the last record that is there in full."""
        self.broken: set[int] = set()
        """Where chunks begin that turned out to be damaged, so far."""
        self._chunks: list[tuple[int, int]] = []
        self._spans: list[tuple[int, int]] = []
        self._data = _mapped(file)
        self._scan()

    @property
    def span_ns(self) -> tuple[int, int]:
        """Times of the first and the last message; 0, 0 where there is none."""
        return min((a for a, _ in self._spans), default=0), max((b for _, b in self._spans), default=0)

    def messages(self, channels: Collection[int] | None = None) -> Iterator[Heard]:
        """Of some channels, or of all, in the order of the file; a damaged chunk is left out and noted in `broken`."""
        for place in self._chunks:
            data = self._opened(*place)
            for opcode, begin, end in _frames(data):
                if opcode == Opcode.MESSAGE:
                    channel, sequence, log_ns, _ = _MESSAGE.unpack_from(data, begin)
                    if channel in self.channels and (channels is None or channel in channels):
                        yield Heard(channel, sequence, log_ns, data[begin + _MESSAGE.size : end])

    def _scan(self) -> None:
        end = len(MAGIC)
        for opcode, begin, end in _frames(self._data, len(MAGIC)):
            if opcode == Opcode.CHUNK:
                self._chunks.append((begin, end))
                first, last = _SPAN.unpack_from(self._data, begin)
                self._spans += [(first, last)] if first else []
            elif opcode == Opcode.FOOTER:
                self.finished = True
                break
            else:
                self._take(opcode, self._data, begin, end)
        self.bytes_left = 0 if self.finished else len(self._data) - end
        if not self.finished:  # no summary repeats the channels
            self._take_channels_of_chunks()

    def _take_channels_of_chunks(self) -> None:
        for place in self._chunks:
            data = self._opened(*place)
            for opcode, begin, end in _frames(data):
                if opcode != Opcode.MESSAGE:
                    self._take(opcode, data, begin, end)

    def _take(self, opcode: int, data: "bytes | mmap.mmap", begin: int, end: int) -> None:
        match opcode:
            case Opcode.CHANNEL:
                channel = _read(Channel.read, data, begin, end)
                self.channels[channel.id] = channel
            case Opcode.SCHEMA:
                schema = _read(Schema.read, data, begin, end)
                self.schemas[schema.id] = schema
            case Opcode.METADATA:
                metadata = _read(Metadata.read, data, begin, end)
                self.metadata[metadata.name] = metadata.metadata
            case Opcode.HEADER:
                header = _read(Header.read, data, begin, end)
                self.profile, self.library = header.profile, header.library
            case Opcode.ATTACHMENT:
                attachment = _read(Attachment.read, data, begin, end)
                self.attachments[attachment.name] = attachment.data
            case _:
                pass

    def _opened(self, begin: int, end: int) -> bytes:
        """The records in a chunk; none of a damaged one."""
        try:
            stream, length = get_chunk_data_stream(_read(Chunk.read, self._data, begin, end), validate_crc=True)
            return stream.read(length)
        except (CRCValidationError, ZstdError, EndOfFile, UnicodeDecodeError, MemoryError):
            self.broken.add(begin)
            return b""


def _mapped(file: Path) -> "bytes | mmap.mmap":
    with file.open("rb") as stream:
        head = stream.read(16)
        if head.startswith(MAGIC):
            return mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    if not head:
        raise NotARecording(f"{file}: is empty")
    known = (what for magic, what in _FOREIGN.items() if head.startswith(magic))
    what = next(known, f"{file.stat().st_size} bytes that are not an MCAP file")
    raise NotARecording(f"{file}: {what}{'' if 'not' in what else ', not an MCAP file'}")


def _frames(data: "bytes | mmap.mmap", begin: int = 0) -> Iterator[tuple[int, int, int]]:
    """Opcode, begin and end of the content of each record that is there in full."""
    size = len(data)
    while begin + _FRAME.size <= size:
        opcode, length = _FRAME.unpack_from(data, begin)
        begin += _FRAME.size
        if begin + length > size:
            return
        yield opcode, begin, begin + length
        begin += length


def _read(read: Callable[[ReadDataStream], R], data: Any, begin: int, end: int) -> R:
    return read(ReadDataStream(BytesIO(data[begin:end])))
