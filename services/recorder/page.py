"""The report of one or several sessions as one HTML page that needs nothing else, on the screen or in ten years."""

import json
from collections.abc import Sequence
from pathlib import Path

from services.recorder.numbers import NUMBERS
from services.recorder.page_data import Data, page_data
from services.recorder.reading import Session

_WEB = Path(__file__).parent / "web"


def write_page(sessions: Sequence[Session], file: Path) -> Path:
    """Write the page; several sessions are laid over and beside each other."""
    names = _names([session.file for session in sessions])
    file.write_text(page([page_data(session, name) for session, name in zip(sessions, names, strict=True)]))
    return file


def page(sessions: Sequence[Data]) -> str:
    """The page's text."""
    numbers = [{"key": n.key, "name": n.name, "unit": n.unit, "definition": n.definition} for n in NUMBERS]
    data = json.dumps({"sessions": sessions, "numbers": numbers}, allow_nan=False, separators=(",", ":"))
    text = (_WEB / "page.html").read_text()
    for mark, content in (
        ("/* page.css */", (_WEB / "page.css").read_text()),
        ("/* plot.js */", (_WEB / "plot.js").read_text()),
        ("/* page.js */", (_WEB / "page.js").read_text()),
        ("/* data */", data.replace("</", "<\\/")),  # a note may hold anything
    ):
        text = text.replace(mark, content)
    return text


def _names(files: Sequence[Path]) -> list[str]:
    """Of the session's folder, or of the file where that says more."""
    resolved = [file.resolve() for file in files]
    return [file.parent.name if file.stem == "session" else file.stem for file in resolved]
