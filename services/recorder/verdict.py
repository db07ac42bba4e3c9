"""Whether a recording holds everything that was said: counted per topic while writing, kept in the file."""

import json
from dataclasses import asdict, dataclass, field, fields
from typing import Self


@dataclass(slots=True)
class Count:
    """One topic. `missing` are gaps in seq; `restarts` how often its publisher began anew; `malformed` was not kept.

    `largest_gap_s` is the longest time between two messages.
    """

    received: int = 0
    missing: int = 0
    restarts: int = 0
    malformed: int = 0
    first_seq: int = 0
    last_seq: int = 0
    largest_gap_s: float = 0.0
    last_ns: int = field(default=0, compare=False)

    def heard(self, seq: int, time_ns: int, *, thinned: bool = False) -> None:
        """Take one message: what was said before the first is not missing, a seq that does not rise is a restart.

        A topic that is `thinned` on its way has gaps that nobody lost.
        """
        if not self.received:
            self.first_seq = seq
        elif seq > self.last_seq:
            self.missing += 0 if thinned else seq - self.last_seq - 1
        else:
            self.restarts += 1
        if self.received:
            self.largest_gap_s = max(self.largest_gap_s, (time_ns - self.last_ns) * 1e-9)
        self.last_ns = time_ns
        self.received += 1
        self.last_seq = seq


@dataclass(slots=True)
class Verdict:
    """All topics. `closed` is false until the recorder has finished the file; `stopped` says why it ended too early."""

    topics: dict[str, Count] = field(default_factory=dict[str, Count])
    closed: bool = False
    stopped: str = ""

    @property
    def received(self) -> int:
        """Messages in the file."""
        return sum(count.received for count in self.topics.values())

    @property
    def lost(self) -> int:
        """Messages that were said and are not in the file."""
        return sum(count.missing + count.malformed for count in self.topics.values())

    def __str__(self) -> str:
        heard = sum(count.received > 0 for count in self.topics.values())
        return f"{self.received} messages on {heard} topics, {self._losses() or 'nothing lost'}"

    def _losses(self) -> str:
        lossy = ((key, count) for key, count in self.topics.items() if count.missing or count.malformed)
        return "; ".join(f"{key}: {count.missing} missing, {count.malformed} malformed" for key, count in lossy)

    def to_json(self) -> str:
        """As it is kept in the file."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Back from `to_json`."""
        raw = json.loads(text)
        known = {field.name for field in fields(Count)}
        topics = {
            key: Count(**{name: n for name, n in count.items() if name in known})
            for key, count in raw["topics"].items()
        }
        return cls(topics, raw["closed"], raw.get("stopped", ""))
