"""A session read back, whether its recording was finished or cut off: columns as numpy arrays, messages, phases.

`Session(file).handle.position_m` reads that topic and no other; what was read is kept as arrays, never as the file.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from pydantic import ValidationError

from schemas.message import Message
from schemas.safety import Phase
from schemas.topics import BY_KEY, SAFETY_STATE, Topic
from services.recorder.columns import Columns
from services.recorder.records import NotARecording, RecordFile
from services.recorder.table import Table, rows, table_of
from services.recorder.verdict import Count, Verdict

__all__ = ["Columns", "Interval", "Log", "NotARecording", "Session", "read"]

M = TypeVar("M", bound=Message)


class Interval(NamedTuple):
    """One stay in a phase, s since the session's start."""

    phase: Phase
    start_s: float
    end_s: float


class Log(NamedTuple):
    """The messages of one topic, in order of arrival, as they were said."""

    payloads: list[bytes]
    times_ns: list[int]


class Session:
    """What a recording holds; of one that was cut off, every whole chunk. A topic is read when it is asked for.

    A topic is an attribute by its key (`session.vehicle_imu`, `session.mocap_frame`) or the first part of it where that
    is one topic (`session.handle`, `session.force`), with a column for each field; see columns.py. What is several
    (`session.mocap`) or none raises an AttributeError that names the choice.
    A recording that was rotated is one session: give its first file.

    Raises:
        NotARecording: a ValueError, where the file is not a recording at all.
    """

    def __init__(self, file: Path | str) -> None:
        self.file = Path(file)
        self.parts = [RecordFile(part) for part in parts_of(self.file)]
        for part in self.parts:
            _refuse_foreign(part)
        self._tables: dict[str, Table] = {}
        self.metadata: Mapping[str, Mapping[str, str]] = _merged(part.metadata for part in self.parts)
        self.attachments: Mapping[str, bytes] = _merged(part.attachments for part in self.parts)

    @cached_property
    def start_ns(self) -> int:
        """Wall-clock time of the earliest message; 0 where there is none."""
        return min((part.span_ns[0] for part in self.parts if part.span_ns[0]), default=0)

    @property
    def duration_s(self) -> float:
        """From the earliest to the latest message."""
        return (max((part.span_ns[1] for part in self.parts), default=0) - self.start_ns) * 1e-9

    @cached_property
    def keys(self) -> list[str]:
        """The topics that have a channel in the file, whether anything was said on them or not."""
        return list(dict.fromkeys(key for part in self.parts for key in _keys(part).values()))

    @cached_property
    def logs(self) -> Mapping[str, Log]:
        """Everything that was said, by topic: the whole recording in memory."""
        return self.logs_of(self.keys)

    def logs_of(self, keys: Iterable[str]) -> dict[str, Log]:
        """What was said on some topics; those on which nothing was said are left out."""
        logs: defaultdict[str, Log] = defaultdict(lambda: Log([], []))
        wanted = set(keys)
        for part in self.parts:
            names = {channel: key for channel, key in _keys(part).items() if key in wanted}
            for channel, _, log_ns, payload in part.messages(names):
                log = logs[names[channel]]
                log.payloads.append(payload)
                log.times_ns.append(log_ns)
        return dict(logs)

    def prepare(self, *topics: Topic[Message] | str) -> None:
        """Read the tables of several topics at once, which takes little longer than reading one."""
        keys = {topic if isinstance(topic, str) else topic.key for topic in topics} - self._tables.keys()
        logs = self.logs_of(keys) if keys else {}
        for key in keys:
            self._tables[key] = self._table(key, logs.pop(key, Log([], [])))

    def table(self, topic: Topic[Message] | str) -> Table:
        """The columns of a topic, see table.py, and `t_s`, s since the session's start; of length 0 where unheard."""
        self.prepare(topic)
        return self._tables[topic if isinstance(topic, str) else topic.key]

    def _table(self, key: str, log: Log) -> Table:
        t_s = (np.array(log.times_ns, np.int64) - self.start_ns) * 1e-9
        try:
            return table_of(BY_KEY[key].type, log.payloads) | {"t_s": t_s}
        except (KeyError, TypeError, ValueError):  # something in it is JSON, but not of this type
            sound = [_is_a(BY_KEY[key].type, payload) for payload in log.payloads]
            kept = [payload for payload, ok in zip(log.payloads, sound, strict=True) if ok]
            return table_of(BY_KEY[key].type, kept) | {"t_s": t_s[sound]}

    def __getattr__(self, name: str) -> Columns:
        if name.startswith("__"):
            raise AttributeError(name)
        return Columns(self.table(_topic_named(name)), name)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *_names()]

    def messages(self, topic: Topic[M]) -> list[M]:
        """The messages themselves.

        Raises pydantic.ValidationError where one is not of the topic's type.
        """
        log = self.logs_of([topic.key]).get(topic.key, Log([], []))
        return [topic.type.model_validate_json(payload) for payload in log.payloads]

    @property
    def phases(self) -> list[Interval]:
        """Each stay in a phase, in order; the last ends with the session."""
        states = self.table(SAFETY_STATE)
        t_s, phase = states["t_s"], states["phase"]
        starts = [i for i in range(len(phase)) if i == 0 or phase[i] != phase[i - 1]]
        ends = [*(float(t_s[i]) for i in starts[1:]), self.duration_s]
        return [Interval(Phase(phase[i]), float(t_s[i]), end) for i, end in zip(starts, ends, strict=bool(starts))]

    @cached_property
    def verdict(self) -> Verdict:
        """The recorder's own, or, where the file was cut off, what can be counted."""
        if self.parts[-1].finished and "clew.verdict" in self.metadata:
            return Verdict.from_json(self.metadata["clew.verdict"]["json"])
        return self.count()

    def count(self) -> Verdict:
        """What the file holds, counted anew."""
        verdict = Verdict({key: Count() for key in self.keys})
        for key, log in self.logs_of(self.keys).items():
            for row, time_ns in zip(rows(log.payloads), log.times_ns, strict=True):
                verdict.topics[key].heard(row["seq"], time_ns)
        return verdict

    @cached_property
    def damage(self) -> str:
        """What could not be read, in words; empty where all could. Looks at every chunk."""
        for part in self.parts:
            for _ in part.messages(()):
                pass
        cut = [_cut(part) for part in self.parts if not part.finished]
        broken = sum(len(part.broken) for part in self.parts)
        return "; ".join([*cut, *([f"{broken} damaged chunks left out"] if broken else [])])


def read(file: Path) -> Session:
    """Read a recording; see Session."""
    return Session(file)


def parts_of(file: Path) -> list[Path]:
    """The file and those in which its recording went on, in order."""
    parts = [file]
    while (after := file.with_name(f"{file.stem}.{len(parts) + 1}{file.suffix}")).is_file():
        parts.append(after)
    return parts


def _cut(part: RecordFile) -> str:
    left = f"{part.bytes_left} bytes of an unfinished record at the end" if part.bytes_left else "its end is not there"
    return f"cut off: {left}"


def _refuse_foreign(part: RecordFile) -> None:
    keys = _keys(part).values()
    if keys and "clew.session" not in part.metadata and not any(key in BY_KEY for key in keys):
        made = " ".join(filter(None, (part.profile, part.library))) or "something else"
        raise NotARecording(f"{part.file}: a recording of {made}, not of Clew: {', '.join(list(keys)[:3])}")


def _keys(part: RecordFile) -> dict[int, str]:
    """Topic of each channel."""
    return {i: channel.metadata.get("key", channel.topic.removeprefix("/")) for i, channel in part.channels.items()}


V = TypeVar("V")


def _merged(each: Iterable[Mapping[str, V]]) -> dict[str, V]:
    """Of all parts; a later one wins."""
    return {name: value for mapping in each for name, value in mapping.items()}


def _is_a(kind: type[Message], payload: bytes) -> bool:
    try:
        kind.model_validate_json(payload)
    except ValidationError:
        return False
    return True


def _names() -> dict[str, Sequence[str]]:
    """Topics by the names that a Session gives them; several for the first part of more than one key."""
    named: defaultdict[str, list[str]] = defaultdict(list)
    for key in BY_KEY:
        whole = key.removeprefix("@").replace("/", "_")
        for name in {whole, whole.partition("_")[0]}:
            named[name].append(key)
    return dict(named)


def _topic_named(name: str) -> str:
    keys = _names().get(name, [])
    if len(keys) == 1:
        return keys[0]
    if keys:
        raise AttributeError(f"{name} is more than one topic: {', '.join(key.replace('/', '_') for key in keys)}")
    raise AttributeError(f"no topic is called {name}: try {', '.join(_single(_names()))}")


def _single(names: Mapping[str, Sequence[str]]) -> Iterator[str]:
    return (name for name, keys in names.items() if len(keys) == 1)
