"""The files of one session: a new one when the last is large or old enough, and none once the disk is nearly full."""

import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from schemas.message import Message
from schemas.topics import Topic
from services.recorder.verdict import Count, Verdict
from services.recorder.writer import Recorder, SessionWriter

OpenPart = Callable[[Path, Verdict, int], SessionWriter]


class Recording:
    """What a recorder holds. The verdict runs on from file to file, so that the last one speaks for all.

    A full disk ends the recording, never the recorder: `stopped` says why, and what came before is kept.
    Raises FileExistsError rather than overwrite a recording, and OSError where it cannot be begun.
    """

    def __init__(
        self, file: Path, topics: Sequence[Topic[Message]], params: Recorder, open_part: OpenPart, now_ns: int
    ) -> None:
        self.verdict = Verdict({topic.key: Count() for topic in topics})
        self.parts = 1
        self.stopped = ""
        self._file, self._params, self._open_part = file, params, open_part
        self._began_ns = now_ns
        self._writer = open_part(file, self.verdict, self.parts)

    def __str__(self) -> str:
        return " ".join(filter(None, (f"STOPPED: {self.stopped};" if self.stopped else "", str(self.verdict))))

    def add(self, key: str, payload: bytes, received_ns: int) -> None:
        """Keep a payload; of a recording that has stopped nothing is counted any more."""
        if not self.stopped:
            self._try(lambda: self._writer.add(key, payload, received_ns))

    def flush(self, now_ns: int) -> None:
        """Hand everything to the operating system; go on in a new file, or stop, where it is time to."""
        if self.stopped:
            return
        self._try(self._writer.flush)
        if not self.stopped:
            self._watch(now_ns)

    def close(self) -> None:
        """Finish the file."""
        if not self.stopped:
            self._try(self._writer.close)

    def _watch(self, now_ns: int) -> None:
        free = shutil.disk_usage(self._file.parent).free
        if free < self._params.free_min_bytes:
            self._stop(f"only {free // 1_000_000} MB are free on the disk")
        elif self._writer.size_bytes > self._params.rotate_bytes or self._age_s(now_ns) > self._params.rotate_s:
            self._try(lambda: self._rotate(now_ns))

    def _age_s(self, now_ns: int) -> float:
        return (now_ns - self._began_ns) * 1e-9

    def _rotate(self, now_ns: int) -> None:
        self._writer.close()
        self.parts, self._began_ns, self.verdict.closed = self.parts + 1, now_ns, False
        file = self._file.with_name(f"{self._file.stem}.{self.parts}{self._file.suffix}")
        self._writer = self._open_part(file, self.verdict, self.parts)

    def _try(self, write: Callable[[], None]) -> None:
        try:
            write()
        except OSError as error:
            self._stop(f"the file cannot be written: {error.strerror}")

    def _stop(self, why: str) -> None:
        self.stopped = self.verdict.stopped = why
        with suppress(OSError):
            self._writer.close()
        with suppress(OSError):
            self._writer.abandon()
