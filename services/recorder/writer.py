"""A session's file: MCAP with JSON messages, one channel per topic, in chunks small enough to lose little to a kill."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Annotated, Self

from annotated_types import Ge, Gt
from mcap.records import Channel, Schema
from mcap.writer import Writer
from pydantic_core import from_json

from schemas.message import Message
from schemas.topics import Topic
from services.parameters import Positive, parameters
from services.recorder.channels import Channels
from services.recorder.schema import schema_text
from services.recorder.verdict import Count, Verdict
from services.runtime.bus import MAX_PAYLOAD_bytes
from services.runtime.hosts import Hosts

_ANOTHER_CLOCK_NS = 5_000_000_000  # a stamp this far from its arrival was made by another host's clock


@parameters
class Recorder:
    """How recordings are cut: a kill loses no more than one flush period, or one chunk where that is less."""

    flush_period_s: Positive
    chunk_bytes: Annotated[int, Gt(0)]
    rotate_bytes: Annotated[int, Gt(0)]
    """A larger file is finished and the session goes on in a new one."""
    rotate_s: Positive
    """As `rotate_bytes`, by age."""
    free_min_bytes: Annotated[int, Ge(0)]
    """With less left on the disk the recording ends."""


class SessionWriter:
    """Writes payloads as they came; of each it reads no more than seq and stamp.

    Stamps inside messages stay as they are, monotonic. In the file a message's time is its stamp plus `epoch_ns`, the
    wall clock's lead over this host's monotonic clock; a publisher on another host gets a lead of its own, by the
    comparison of the clocks (`hosts`), and until there is one from the first message that arrives. `metadata` and
    `attachments` come first in the file, so that a kill leaves them.
    Raises FileExistsError rather than overwrite a recording.
    """

    def __init__(
        self,
        file: Path,
        topics: Sequence[Topic[Message]],
        *,
        epoch_ns: int,
        chunk_bytes: int,
        metadata: Mapping[str, str] | None = None,
        attachments: Mapping[str, bytes] | None = None,
        verdict: Verdict | None = None,
        hosts: Hosts | None = None,
    ) -> None:
        self._publisher = {topic.key: topic.publisher for topic in topics}
        self._hosts = hosts or Hosts()
        self._thinned = {topic.key for topic in topics if topic.radio_Hz and self._hosts.crosses(topic.publisher)}
        self.verdict = verdict or Verdict({topic.key: Count() for topic in topics})
        self._leads_ns = [epoch_ns]
        self._lead_of = dict.fromkeys(self.verdict.topics, epoch_ns)
        file.parent.mkdir(parents=True, exist_ok=True)
        self._stream = file.open("xb")
        self._writer = Writer(self._stream, chunk_size=chunk_bytes)
        self._writer.start(profile="", library="clew")
        self._writer.add_metadata("clew.session", dict(metadata or {}))
        self._writer.add_metadata("clew.clock", {"epoch_minus_monotonic_ns": str(epoch_ns)})
        for name, data in (attachments or {}).items():
            self._writer.add_attachment(0, epoch_ns, name, "text/plain", data)
        self._written = 0
        self._channels = Channels(self._writer, self._stream)
        self._channel_of = {topic.key: self._channels.add(*_channel(topic)) for topic in topics}
        self._writer.flush()

    def add(self, key: str, payload: bytes, received_ns: int) -> None:
        """Keep one payload that arrived at `received_ns` of this host's monotonic clock, or count why not."""
        count = self.verdict.topics[key]
        header = _header(payload)
        if header is None:
            count.malformed += 1
            return
        seq, stamp_ns = header
        here_ns = self._hosts.here_ns(self._publisher[key], stamp_ns) if self._hosts.two else None
        time_ns = here_ns + self._leads_ns[0] if here_ns else stamp_ns + self._lead_ns(key, stamp_ns, received_ns)
        count.heard(seq, time_ns, thinned=key in self._thinned)
        self._written += 1
        self._writer.add_message(self._channel_of[key], time_ns, payload, time_ns, seq)

    def _lead_ns(self, key: str, stamp_ns: int, received_ns: int) -> int:
        """What to add to a stamp of this topic to get wall-clock time."""
        now_ns = received_ns + self._leads_ns[0]
        if abs(now_ns - stamp_ns - self._lead_of[key]) > _ANOTHER_CLOCK_NS:
            known = (lead for lead in self._leads_ns if abs(now_ns - stamp_ns - lead) <= _ANOTHER_CLOCK_NS)
            self._lead_of[key] = next(known, now_ns - stamp_ns)
            self._leads_ns = list(dict.fromkeys((*self._leads_ns, self._lead_of[key])))
        return self._lead_of[key]

    @property
    def size_bytes(self) -> int:
        """Of the file so far."""
        return self._stream.tell()

    def flush(self) -> None:
        """Hand everything to the operating system: from here on a kill cannot lose it."""
        self._writer.flush()

    def close(self) -> None:
        """Write the verdict and the index, and close the file; again is harmless."""
        if self._stream.closed:
            return
        self.verdict.closed = True
        leads = {key: str(lead - self._leads_ns[0]) for key, lead in self._lead_of.items() if lead != self._leads_ns[0]}
        if leads:
            self._writer.add_metadata("clew.clock.other_hosts_ns", leads)
        self._writer.add_metadata("clew.verdict", {"json": self.verdict.to_json()})
        self._channels.finish(self._written)
        self._writer.finish()
        self._stream.close()

    def abandon(self) -> None:
        """Let go of a file that cannot be finished."""
        self._stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _channel(topic: Topic[Message]) -> tuple[Channel, Schema]:
    schema = Schema(id=0, name=topic.type.__name__, encoding="jsonschema", data=schema_text(topic.type))
    name = channel_name(topic.key)
    return Channel(id=0, topic=name, message_encoding="json", schema_id=0, metadata={"key": topic.key}), schema


def channel_name(key: str) -> str:
    """The topic's name in the file: a slash before the key, less the bus's verbatim mark, which viewers cannot type."""
    return "/" + key.replace("@", "")


def _header(payload: bytes) -> tuple[int, int] | None:
    """seq and stamp_ns of a payload, None where it is not a finite JSON object with both."""
    if len(payload) > MAX_PAYLOAD_bytes:
        return None
    try:
        raw = from_json(payload, allow_inf_nan=False)
        seq, stamp_ns = raw["seq"], raw["stamp_ns"]
    except (ValueError, TypeError, KeyError):
        return None
    whole = type(seq) is int and type(stamp_ns) is int
    return (seq, stamp_ns) if whole and 0 <= seq < 2**32 and 0 <= stamp_ns < 2**62 else None
