"""Where recordings are, and how a command says that one is no good."""

import sys
from pathlib import Path

FILE = "session.mcap"


def session_file(given: Path) -> Path:
    """A recording from its own name or its folder's.

    Raises:
        FileNotFoundError: there is none.
    """
    file = given / FILE if given.is_dir() else given
    if not file.is_file():
        raise FileNotFoundError(f"{given}: no recording there")
    return file


def complain(error: Exception) -> int:
    """One line on stderr; the exit code for bad input."""
    print(error, file=sys.stderr)  # noqa: T201
    return 2
