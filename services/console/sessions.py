"""`clew check`, `recover`, `sessions` and `note`: looking after recordings."""

import asyncio
import json
import os
import socket
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from schemas.note import OperatorNote
from schemas.topics import BY_KEY, NOTE
from services.config import ConfigError, load, told_in
from services.console.operator import operator_node
from services.console.start import clock_of, observer_bus
from services.recorder.figures import draw_all
from services.recorder.inspection import Findings, inspect
from services.recorder.page import write_page
from services.recorder.reading import Session
from services.recorder.recovery import recover
from services.recorder.walk import NO_PHASE_2, guided
from services.runtime.zenoh_bus import open_bus
from services.session_files import FILE, complain, session_file

WIDE = 200
_LINK_S = 0.3  # until a new session's links carry what it says, and until they have carried it


def check(given: Path) -> int:
    """Print what a recording holds. Returns 0 where it is complete, 1 where not, 2 where it is no recording."""
    try:
        session = Session(session_file(given))
        findings = inspect(session)
    except (OSError, ValueError) as error:
        return complain(error)
    console = _console()
    console.print(_topics(findings))
    console.print("; ".join(f"{name} {value}" for name, value in _origin(session).items() if value), soft_wrap=True)
    for remark in findings.remarks:
        console.print(f"note: {remark}", soft_wrap=True, highlight=False)
    for reason in findings.lacking:
        console.print(f"• {reason}", style="red", soft_wrap=True, highlight=False)
    console.print(
        "complete" if findings.complete else "NOT complete", style="bold green" if findings.complete else "bold red"
    )
    return 0 if findings.complete else 1


def save(given: Path, out: Path | None) -> int:
    """Recover a recording. Returns 0 where it was saved, or is whole; 1 where nothing is left; 2 where it cannot be read."""
    try:
        file = session_file(given)
        session = Session(file)
        if not session.damage:
            print(f"{file} is whole: nothing to recover")  # noqa: T201
            return 0
        target = out or file.with_name(f"{file.stem}.recovered{file.suffix}")
        kept = recover(session, target)
    except (OSError, ValueError) as error:
        return complain(error)
    print(f"{session.damage}\n{kept} messages, {session.duration_s:.1f} s: {target}")  # noqa: T201
    return 0 if kept else 1


def report(given: Sequence[Path], out: Path | None, figures: Path | None) -> int:
    """Write the page of one or several sessions, and the paper's figures. Returns 2 where one is no recording."""
    try:
        sessions = [Session(session_file(one)) for one in given]
        alone = sessions[0].file.parent if len(sessions) == 1 else Path()
        print(write_page(sessions, out or alone / "report.html"))  # noqa: T201
        for session in sessions:
            if not guided(session):
                print(f"{session.file}: {NO_PHASE_2}", file=sys.stderr)  # noqa: T201
        for session in sessions if figures else []:
            folder = figures / session.file.resolve().parent.name if figures else Path()
            for suffix in (".png", ".pdf"):
                print(*draw_all(session, folder, suffix), sep="\n")  # noqa: T201
    except (OSError, ValueError) as error:
        return complain(error)
    return 0


def overview(folder: Path) -> int:
    """A line for each session under `folder`, the newest last. Returns 2 where the folder does not exist."""
    if not folder.is_dir():
        return complain(FileNotFoundError(f"{folder}: no such folder"))
    table = Table(
        "session", "length", "MB", "profile", "path", "person", "subject", "condition", "phase 2", "recording", "ok"
    )
    for file in sorted(folder.glob(f"*/{FILE}")):
        if not file.parent.is_symlink():
            table.add_row(file.parent.name, *_line(file))
    _console().print(table)
    return 0


def note(text: str, profile: str) -> int:
    """Say a remark to whoever records. Returns 1 where nobody does, 2 for bad configuration or an empty remark."""
    try:
        config = load(profile)
        with told_in(profile):
            buses = observer_bus(config)
    except ConfigError as error:
        return complain(error)
    if not text.strip():
        return complain(ValueError("note: is empty"))
    name = f"note-{os.getpid()}"

    async def say() -> int:
        with open_bus(buses, name) as bus:
            if "recorder" not in bus.alive(_LINK_S):
                print(f"no recorder runs in {config.system.name}: the note is not kept", file=sys.stderr)  # noqa: T201
                return 1
            author = f"{os.environ.get('USER', 'operator')}@{socket.gethostname()}"
            person = operator_node(bus, clock_of(config, bus), buses.placement)
            person.publisher(NOTE).publish(OperatorNote(operator=author, text=text))
            await asyncio.sleep(_LINK_S)
        return 0

    return asyncio.run(say())


def _console() -> Console:
    console = Console()
    return console if console.is_terminal else Console(width=WIDE)


def _topics(findings: Findings) -> Table:
    table = Table("topic", "received", "missing", "malformed", "restarts", "largest gap", "period")
    for column in table.columns[1:]:
        column.justify = "right"
    for key, count in findings.counts.items():
        rate_Hz = BY_KEY[key].rate_Hz if key in BY_KEY else 0.0
        period = f"{1e3 / rate_Hz:.0f} ms" if rate_Hz else "-"
        gap = f"{1e3 * count.largest_gap_s:.0f} ms" if count.received > 1 else "-"
        numbers = map(str, (count.received, count.missing, count.malformed, count.restarts))
        table.add_row(key, *numbers, gap, period)
    return table


def _origin(session: Session) -> dict[str, str]:
    return dict(session.metadata.get("clew.session", {}))


def _line(file: Path) -> tuple[str, ...]:
    """What can be said of a session without reading its messages."""
    try:
        session = Session(file)
    except (OSError, ValueError) as error:
        return ("", f"{file.stat().st_size / 1e6:.1f}", *[""] * 6, str(error), "")
    told, verdict = _origin(session), session.metadata.get("clew.verdict")
    finished = session.parts[-1].finished and verdict is not None
    state = str(session.verdict.lost or "whole") if finished else "cut off"
    summary = _summary(file.with_name("summary.json"))
    return (
        f"{session.duration_s:.0f} s",
        f"{sum(part.file.stat().st_size for part in session.parts) / 1e6:.1f}",
        *(told.get(name, "") for name in ("profile", "path", "person", "subject", "condition")),
        f"{summary.get('durations_s', {}).get('guiding', 0.0):.0f} s" if summary else "",
        f"{state} lost" if state.isdigit() else state,
        "" if not summary else "yes" if summary.get("ok") else "NO",
    )


def _summary(file: Path) -> dict[str, Any]:
    try:
        return json.loads(file.read_text())
    except (OSError, ValueError):
        return {}
