"""A session read back, whether its recording was finished or cut off."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from mcap.records import Attachment, Channel, Chunk, Footer, McapRecord, Metadata
from mcap.records import Message as Record
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk
from pydantic import ValidationError
from zstandard import ZstdError

from schemas.message import Message
from schemas.safety import Phase
from schemas.topics import BY_KEY, SAFETY_STATE, Topic
from services.recorder.table import Row, Table, rows, table
from services.recorder.verdict import Count, Verdict

M = TypeVar("M", bound=Message)

MAGIC = bytes((0x89, *b"MCAP0\r\n"))
_FRAME = 9  # opcode and length of a record


class Interval(NamedTuple):
    """One stay in a phase, s since the session's start."""

    phase: Phase
    start_s: float
    end_s: float


class Log(NamedTuple):
    """The messages of one topic, in order of arrival, as they were said."""

    payloads: list[bytes]
    times_ns: list[int]


@dataclass
class Session:
    """What a recording holds. `damage` says in words what could not be read, empty where all could."""

    logs: Mapping[str, Log]
    metadata: Mapping[str, Mapping[str, str]]
    attachments: Mapping[str, bytes]
    verdict: Verdict
    damage: str
    _tables: dict[str, Table] = field(default_factory=dict[str, Table])

    @property
    def start_ns(self) -> int:
        """Wall-clock time of the earliest message; 0 where there is none."""
        return min((min(log.times_ns) for log in self.logs.values() if log.times_ns), default=0)

    @property
    def duration_s(self) -> float:
        """From the earliest to the latest message."""
        last = max((max(log.times_ns) for log in self.logs.values() if log.times_ns), default=0)
        return (last - self.start_ns) * 1e-9

    def table(self, topic: Topic[Message] | str) -> Table:
        """The columns of a topic, see table.py, and `t_s`, s since the session's start; of length 0 where unheard."""
        key = topic if isinstance(topic, str) else topic.key
        if key not in self._tables:
            self._tables[key] = self._read(key)
        return self._tables[key]

    def _read(self, key: str) -> Table:
        log = self.logs.get(key, Log([], []))
        t_s = (np.array(log.times_ns, np.int64) - self.start_ns) * 1e-9
        try:
            return table(BY_KEY[key].type, rows(log.payloads)) | {"t_s": t_s}
        except (KeyError, TypeError, ValueError):  # something in it is JSON, but not of this type
            sound = [_is_a(BY_KEY[key].type, payload) for payload in log.payloads]
            kept: list[Row] = rows([payload for payload, ok in zip(log.payloads, sound, strict=True) if ok])
            return table(BY_KEY[key].type, kept) | {"t_s": t_s[sound]}

    def messages(self, topic: Topic[M]) -> list[M]:
        """The messages themselves.

        Raises pydantic.ValidationError where one is not of the topic's type.
        """
        return [topic.type.model_validate_json(payload) for payload in self.logs.get(topic.key, Log([], [])).payloads]

    @property
    def phases(self) -> list[Interval]:
        """Each stay in a phase, in order; the last ends with the session."""
        states = self.table(SAFETY_STATE)
        t_s, phase = states["t_s"], states["phase"]
        starts = [i for i in range(len(phase)) if i == 0 or phase[i] != phase[i - 1]]
        ends = [*(float(t_s[i]) for i in starts[1:]), self.duration_s]
        return [Interval(Phase(phase[i]), float(t_s[i]), end) for i, end in zip(starts, ends, strict=bool(starts))]


def _is_a(kind: type[Message], payload: bytes) -> bool:
    try:
        kind.model_validate_json(payload)
    except ValidationError:
        return False
    return True


def read(file: Path) -> Session:
    """Read a recording; of one that was cut off, every whole chunk.

    Raises ValueError where the file is not a recording at all.
    """
    data = file.read_bytes()
    if not data.startswith(MAGIC):
        raise ValueError(f"{file}: {len(data)} bytes that are not an MCAP file")
    return _Reading().session(data)


class _Reading:
    """Gathers a file's records."""

    def __init__(self) -> None:
        self.channels: dict[int, str] = {}
        self.logs: dict[str, Log] = {}
        self.metadata: dict[str, Mapping[str, str]] = {}
        self.attachments: dict[str, bytes] = {}
        self.finished = False
        self.broken_chunks = 0

    def session(self, data: bytes) -> Session:
        whole = _end_of_last_whole_record(data)
        stream = BytesIO(data[:whole])
        stream.seek(len(MAGIC))
        records = StreamReader(stream, skip_magic=True, emit_chunks=True, record_size_limit=None).records
        while stream.tell() < whole and not self.finished:
            self._take(next(records))
        return Session(self.logs, self.metadata, self.attachments, self._verdict(), self._damage(len(data) - whole))

    def _take(self, record: McapRecord) -> None:
        match record:
            case Chunk():
                self._take_chunk(record)
            case Channel():
                self.channels[record.id] = record.metadata.get("key", record.topic.removeprefix("/"))
            case Record() if record.channel_id in self.channels:  # else the chunk that named it is damaged
                log = self.logs.setdefault(self.channels[record.channel_id], Log([], []))
                log.payloads.append(record.data)
                log.times_ns.append(record.log_time)
            case Metadata():
                self.metadata[record.name] = record.metadata
            case Attachment():
                self.attachments[record.name] = record.data
            case Footer():
                self.finished = True
            case _:
                pass

    def _take_chunk(self, chunk: Chunk) -> None:
        try:
            records = breakup_chunk(chunk, validate_crc=True)
        except (CRCValidationError, ZstdError):
            self.broken_chunks += 1
            return
        for record in records:
            self._take(record)

    def _verdict(self) -> Verdict:
        """The recorder's own, or, where the file was cut off, what can be counted."""
        if "clew.verdict" in self.metadata:
            return Verdict.from_json(self.metadata["clew.verdict"]["json"])
        verdict = Verdict({key: Count() for key in self.channels.values()})
        for key, log in self.logs.items():
            for row in rows(log.payloads):
                verdict.topics[key].heard(row["seq"])
        return verdict

    def _damage(self, bytes_left: int) -> str:
        cut = "" if self.finished else f"cut off: {bytes_left} bytes of an unfinished record at the end"
        broken = f"{self.broken_chunks} damaged chunks left out" if self.broken_chunks else ""
        return "; ".join(filter(None, (cut, broken)))


def _end_of_last_whole_record(data: bytes) -> int:
    """Where the last record ends that is there in full (a footer ends with the closing magic)."""
    end = len(MAGIC)
    while end + _FRAME <= len(data):
        after = end + _FRAME + int.from_bytes(data[end + 1 : end + _FRAME], "little")
        if after > len(data):
            break
        end = after
    return end
