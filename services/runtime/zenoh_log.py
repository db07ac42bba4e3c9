"""Reads along what Zenoh logs, because some of what it does it tells nowhere else. The log is on standard output.

Whoever puts on the bus chooses part of that text: a key may hold line breaks, so a line of the log could be made up.
What cannot be made up is the colour in front of each true line, because Zenoh escapes the escape character elsewhere.
"""

import fcntl
import os
import re
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress

from services.runtime.bus_config import LogReader

_TRUE = b"\x1b[2m"
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_PIPE_bytes, _CHUNK_bytes = 1 << 20, 1 << 16
_BATCH_s = 0.05
"""Between two looks: Zenoh writes each line by itself, and a look for each would cost more than the line."""


@contextmanager
def read_along(reader: LogReader) -> Generator[None]:
    """Inside, standard output goes through `reader`."""
    os.environ.pop("NO_COLOR", None)  # Zenoh would obey it, and then its lines could not be told from made-up ones
    out, (read, write) = os.dup(1), os.pipe()
    with suppress(OSError):
        fcntl.fcntl(read, fcntl.F_SETPIPE_SZ, _PIPE_bytes)  # Zenoh waits where it is full
    os.dup2(write, 1)
    os.close(write)
    following = threading.Thread(target=_follow, args=(reader, read, out), name="log", daemon=True)
    following.start()
    try:
        yield
    finally:
        os.dup2(out, 1)
        following.join(1.0)


def _follow(reader: LogReader, log: int, out: int) -> None:
    rest, shown = b"", True
    while chunk := os.read(log, _CHUNK_bytes):
        *lines, rest = (rest + chunk).split(b"\n")
        for line in lines:
            if line.startswith(_TRUE):
                shown = reader.note(_COLOURS.sub("", line.decode(errors="replace")))
            if shown:  # what is no true line belongs to the one before
                os.write(out, line + b"\n")
        if len(chunk) < _CHUNK_bytes:
            time.sleep(_BATCH_s)
