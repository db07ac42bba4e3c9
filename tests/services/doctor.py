"""The rules of `mcap doctor`, the format's own checker, which is a program that not every machine has.

Each rule has a name, and a finding begins with it. Where the program is there (`mcap` on the PATH), the tests ask it too.
"""

import zlib
from collections.abc import Iterator
from io import BytesIO
from struct import Struct
from typing import Any

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    MessageIndex,
    Metadata,
    Schema,
    Statistics,
)  # fmt: skip

MAGIC = b"\x89MCAP0\r\n"
_FRAME = Struct("<BQ")
_PARSED: dict[int, Any] = {
    Opcode.HEADER: Header, Opcode.FOOTER: Footer, Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk, Opcode.CHUNK_INDEX: ChunkIndex, Opcode.STATISTICS: Statistics, Opcode.METADATA: Metadata,
    Opcode.MESSAGE_INDEX: MessageIndex, Opcode.DATA_END: DataEnd,
}  # fmt: skip


def examine(data: bytes) -> list[str]:
    """What the doctor would call an error or, but for the order of log times, warn of."""
    patient = _Patient(data)
    return list(patient.findings())


class _Patient:
    def __init__(self, data: bytes) -> None:
        self.data = data
        self.known: dict[int, dict[int, Any]] = {Opcode.SCHEMA: {}, Opcode.CHANNEL: {}}
        self.repeated: dict[int, set[int]] = {Opcode.SCHEMA: set(), Opcode.CHANNEL: set()}
        self.used: set[int] = set()
        self.chunks: dict[int, Chunk] = {}
        self.times: list[int] = []

    def findings(self) -> Iterator[str]:
        if not (self.data.startswith(MAGIC) and self.data.endswith(MAGIC)):
            yield "magic: the file does not begin and end with it"
        records = list(_records(self.data, len(MAGIC)))
        opcodes = [opcode for opcode, _, _ in records]
        for needed in (Opcode.HEADER, Opcode.DATA_END, Opcode.FOOTER):
            if opcodes.count(needed) != 1:
                yield f"frame: {opcodes.count(needed)} {needed.name} records"
        summary = False
        for opcode, at, content in records:
            summary = summary or opcode == Opcode.DATA_END
            yield from self._record(opcode, at, content, summary=summary)
        for kind, used in ((Opcode.CHANNEL, self.used), (Opcode.SCHEMA, self._schemas_used())):
            for n in used - self.repeated[kind]:
                yield f"summary: {kind.name} {n} has messages and is not repeated in the summary"

    def _schemas_used(self) -> set[int]:
        return {self.known[Opcode.CHANNEL][n].schema_id for n in self.used if n in self.known[Opcode.CHANNEL]} - {0}

    def _record(self, opcode: int, at: int, content: Any, *, summary: bool) -> Iterator[str]:
        match opcode:
            case Opcode.HEADER:
                if not content.library:
                    yield "header: no library"
                if content.profile not in ("", "ros1", "ros2"):
                    yield f"header: profile {content.profile!r}"
            case Opcode.SCHEMA | Opcode.CHANNEL:
                yield from self._definition(opcode, content, summary=summary)
            case Opcode.CHUNK:
                self.chunks[at] = content
                yield from self._chunk(content)
            case Opcode.MESSAGE:
                yield "message: outside a chunk"
            case Opcode.CHUNK_INDEX:
                yield from self._index(content)
            case Opcode.STATISTICS:
                yield from self._statistics(content)
            case _:
                pass

    def _definition(self, kind: int, content: Any, *, summary: bool) -> Iterator[str]:
        name, known = Opcode(kind).name, self.known[kind]
        if content.id == 0 and kind == Opcode.SCHEMA:
            yield "schema: number 0"
        if content.id in known and known[content.id] != content:
            yield f"definition: two {name} records {content.id} that differ"
        if kind == Opcode.SCHEMA and not content.encoding:
            yield f"schema: {content.id} has no encoding"
        if kind == Opcode.CHANNEL and content.schema_id and content.schema_id not in self.known[Opcode.SCHEMA]:
            yield f"channel: {content.id} has the unknown schema {content.schema_id}"
        if summary:
            self.repeated[kind].add(content.id)
            if content.id not in known:
                yield f"summary: {name} {content.id} is not in the data"
        elif content.id in known:
            yield f"definition: {name} {content.id} is there twice"
        else:
            known[content.id] = content

    def _chunk(self, chunk: Chunk) -> Iterator[str]:
        try:
            data = _unpacked(chunk)
        except zstandard.ZstdError as error:
            yield f"chunk: {error}"
            return
        if len(data) != chunk.uncompressed_size:
            yield f"chunk: {len(data)} bytes, not {chunk.uncompressed_size}"
        if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            yield "chunk: checksum"
        times: list[int] = []
        for opcode, _, content in _records(data, 0):
            match opcode:
                case Opcode.MESSAGE:
                    times.append(content.log_time)
                    if content.channel_id not in self.known[Opcode.CHANNEL]:
                        yield f"message: of channel {content.channel_id} before its record"
                    self.used.add(content.channel_id)
                case Opcode.SCHEMA | Opcode.CHANNEL:
                    yield from self._definition(opcode, content, summary=False)
                case _:
                    yield f"chunk: holds a record {opcode}"
        self.times += times
        if times and (min(times), max(times)) != (chunk.message_start_time, chunk.message_end_time):
            yield "chunk: its times are not those of its messages"

    def _index(self, index: ChunkIndex) -> Iterator[str]:
        chunk = self.chunks.pop(index.chunk_start_offset, None)
        if chunk is None:
            yield f"index: no chunk at {index.chunk_start_offset}, or two indexes of it"
            return
        told = (index.message_start_time, index.message_end_time, index.compression, index.compressed_size,
                index.uncompressed_size)  # fmt: skip
        found = (chunk.message_start_time, chunk.message_end_time, chunk.compression, len(chunk.data),
                 chunk.uncompressed_size)  # fmt: skip
        if told != found:
            yield f"index: {told}, the chunk {found}"
        length = _FRAME.unpack_from(self.data, index.chunk_start_offset)[1]
        if index.chunk_length != length + _FRAME.size:
            yield f"index: length {index.chunk_length}, the chunk {length + _FRAME.size}"

    def _statistics(self, statistics: Statistics) -> Iterator[str]:
        told = statistics.message_count, statistics.message_start_time, statistics.message_end_time
        found = len(self.times), min(self.times, default=0), max(self.times, default=0)
        if told != found:
            yield f"statistics: {told}, the messages {found}"


def _records(data: bytes, begin: int) -> Iterator[tuple[int, int, Any]]:
    """Opcode, place and content of each; content is None where no rule looks into it."""
    while begin + _FRAME.size <= len(data):
        opcode, length = _FRAME.unpack_from(data, begin)
        content = data[begin + _FRAME.size : begin + _FRAME.size + length]
        if len(content) < length:
            return
        yield opcode, begin, _parsed(opcode, content)
        begin += _FRAME.size + length
        if opcode == Opcode.FOOTER:
            return


def _unpacked(chunk: Chunk) -> bytes:
    if not chunk.compression:
        return chunk.data
    return zstandard.ZstdDecompressor().decompress(chunk.data, chunk.uncompressed_size)


def _parsed(opcode: int, content: bytes) -> Any:
    stream = ReadDataStream(BytesIO(content))
    if opcode == Opcode.MESSAGE:
        return Message.read(stream, len(content))
    return _PARSED[opcode].read(stream) if opcode in _PARSED else None
