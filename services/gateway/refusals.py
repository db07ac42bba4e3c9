"""Who knocked on the radio's door without a valid certificate: Zenoh says so only in its log, on standard output."""

import os
import re
import threading
from collections.abc import Generator
from contextlib import contextmanager

LOG_LEVELS = "error,zenoh_link_tls=warn,zenoh_link_commons=warn"
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_REASON = re.compile(r'reason: "([^"]+)"')
_GIVEN_UP = re.compile(r"ConnectionClosed|ApplicationClosed|LocallyClosed|TimedOut|Reset")  # by whom a radio cut off
_FROM_LINK = re.compile(r"WARN .*zenoh_link_\w+\S*: (.*)")


class Refusals:
    """Counts them while the log goes on to where it went."""

    def __init__(self) -> None:
        self.count = 0
        self.last = ""

    def note(self, line: str) -> None:
        """Look at one line of the log."""
        found = _FROM_LINK.search(_COLOURS.sub("", line))
        if found and not _GIVEN_UP.search(found[1]):
            self.count += 1
            said = found[1].split(" Hint")[0].strip(" .")
            reason = _REASON.search(said)  # QUIC's, among much else
            self.last = reason[1] if reason else said

    def __str__(self) -> str:
        return f"{self.count} sessions refused ({self.last})" if self.count else ""


@contextmanager
def listening() -> Generator[Refusals]:
    """Read along with this process's standard output."""
    refusals = Refusals()
    out, (read, write) = os.dup(1), os.pipe()
    os.dup2(write, 1)
    os.close(write)

    def follow() -> None:
        with os.fdopen(read, errors="replace") as log:
            for line in log:
                os.write(out, line.encode())
                refusals.note(line)

    threading.Thread(target=follow, name="log", daemon=True).start()
    try:
        yield refusals
    finally:
        os.dup2(out, 1)
