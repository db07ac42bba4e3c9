"""What was recorded of what a service says and hears: bytes, and the rows that they mean, parsed once."""

from collections.abc import Sequence

from schemas.topics import TOPICS
from services.recorder.reading import Session
from services.recorder.table import Row, rows


class Tape:
    """What was recorded of what a service says and hears: bytes, and the rows that they mean, parsed once."""

    def __init__(self, session: Session, service: str) -> None:
        own = [topic.key for topic in TOPICS if service == topic.publisher or service in topic.subscribers]
        self._logs = session.logs_of(own)
        self._rows: dict[str, list[Row]] = {}
        self._places: dict[str, dict[int, list[int]]] = {}
        self._start_ns = session.start_ns

    def t_s(self, time_ns: int) -> float:
        """Since the session's start, of a time in the file."""
        return (time_ns - self._start_ns) * 1e-9

    def said_ns(self, key: str, i: int) -> int:
        """When message `i` was said, in the file's time: that of every host."""
        row = self.rows(key)[i]
        return self._logs[key].times_ns[i] + row["said_ns"] - row["stamp_ns"]

    def payloads(self, key: str) -> Sequence[bytes]:
        """As they were said."""
        return self._logs[key].payloads if key in self._logs else []

    def rows(self, key: str) -> list[Row]:
        """The parsed messages."""
        if key not in self._rows:
            self._rows[key] = rows(self.payloads(key))
        return self._rows[key]

    def place(self, key: str, seq: int, by_ns: int) -> int | None:
        """Where the message with that seq stands that a turn at `by_ns` can have taken in; None where nowhere."""
        if key not in self._places:
            self._places[key] = {}
            for i, row in enumerate(self.rows(key)):
                self._places[key].setdefault(row["seq"], []).append(i)
        found = self._places[key].get(seq, [])
        if len(found) < 2:
            return found[0] if found else None
        before = [i for i in found if self._logs[key].times_ns[i] <= by_ns]
        return before[-1] if before else found[0]
