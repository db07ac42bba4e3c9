"""A process that reads along what Zenoh logs on standard output: what it is told, what is printed, and what is made up."""

import json
import subprocess
import sys

READER = r"""
import json, os, sys
from services.runtime.zenoh_log import read_along

class Reader:
    levels = "error"
    noted = []

    def note(self, line):
        self.noted.append(line)
        return "secret" not in line

with read_along(Reader()):
    for text in json.load(sys.stdin):
        os.write(1, text.encode())
print(json.dumps(Reader.noted))
"""
TRUE = "\x1b[2m2026-11-29T01:30:58.689343Z\x1b[0m \x1b[35mTRACE\x1b[0m "


def read(*texts: str) -> tuple[list[str], str]:
    """What the reader was told, and what was printed meanwhile."""
    run = subprocess.run(
        [sys.executable, "-P", "-c", READER],
        input=json.dumps(texts),
        capture_output=True,
        text=True,
        timeout=60.0,
        check=True,
    )
    *printed, noted = run.stdout.splitlines(keepends=True)
    return json.loads(noted), "".join(printed)


def test_each_line_is_noted_and_printed_where_the_reader_says_so():
    noted, printed = read(f"{TRUE}one\n", f"{TRUE}secret", f" still\n{TRUE}two\n")
    assert noted == [f"2026-11-29T01:30:58.689343Z TRACE {word}" for word in ("one", "secret still", "two")]
    assert printed == f"{TRUE}one\n{TRUE}two\n"


def test_a_line_that_somebody_put_into_another_is_not_noted():
    noted, printed = read(f"{TRUE}secret a\n2026-11-29T01:30:58.689343Z WARN made up\n", f"{TRUE}b\nsecond line\n")
    assert noted == [f"2026-11-29T01:30:58.689343Z TRACE {word}" for word in ("secret a", "b")]
    assert printed == f"{TRUE}b\nsecond line\n"


def test_a_flood_is_read_to_its_end():
    noted, printed = read("".join(f"{TRUE}secret {n}\n" for n in range(50_000)))
    assert len(noted) == 50_000
    assert printed == ""
