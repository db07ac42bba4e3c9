"""`clew explain`: where the energy of a recorded session went, and whether every port was passive."""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from schemas.topics import ENERGY
from services.px4_bridge.energy import ROUNDING_J
from services.recorder import figures, metrics, reading
from services.recorder.passivity import Books, Walk, filter_books, physical_books, walk, worst
from services.recorder.reading import Session
from services.recorder.walk import NO_PHASE_2, guided
from services.session_files import session_file

TOLD_J = 1e-6
"""A fall of what a port dissipated is told from here on: far below anything that can be felt."""
UNKNOWN = "unknown"
SUMS = (
    ("guidance, by u_A,xy", "guidance_J"),
    ("height, by u_A,z", "height_J"),
    ("cable, by -f_c", "cable_J"),
    ("a hand that came near", "hand_J"),
    ("from position mode", "handed_J"),
    ("dissipated", "dissipated_J"),
    ("unaccounted for", "residual_J"),
)


def explain(given: Path, out: Path | None) -> int:
    """Print the tables and write energy.png beside the recording, or into `out`.

    Returns the exit code: 0, 1 where the filter made energy, 2 where there is no recording to read or nowhere to write.
    """
    try:
        file = session_file(given)
        session = reading.read(file)
        if not session.logs:
            raise ValueError(f"{file}: no message can be read; {session.damage or 'the recording is empty'}")
        drawn = figures.draw("energy.png", session, out or file.parent)
    except (OSError, ValueError) as error:
        print(f"clew explain: {_plain(error)}", file=sys.stderr)  # noqa: T201
        return 2
    console = Console()
    console.print(tables(session))
    console.print(f"figure: {drawn}", soft_wrap=True, highlight=False, markup=False)
    return 1 if _made_J(session) > ROUNDING_J else 0


def tables(session: Session) -> RenderableType:
    """The ports, V and the tank, and a verdict in words."""
    return Group(_ports(session), _lyapunov(session), *_verdict(session))


def _ports(session: Session) -> Table:
    filtered, physical = filter_books(session), physical_books(session)
    table = _table("energy through the filter", "estimated, f̂_c", "physical, f_c")
    for label, name in SUMS:
        table.add_row(label, *(_last_J(books, name) for books in (filtered, physical)))
    falls = [_fall(session, books) for books in (filtered, physical)]
    table.add_row("worst violation", *(amount for amount, _ in falls))
    table.add_row("", *(when for _, when in falls))
    return table


def _lyapunov(session: Session) -> Table:
    walked = walk(session)
    table = _table("V of the walk, true states", "")
    lacks = "needs the simulator's truth and the path" if guided(session) else NO_PHASE_2
    for label, value in _walk_rows(session, walked) if walked else [("V", f"{UNKNOWN}: {lacks}")]:
        table.add_row(label, value)
    return table


def _walk_rows(session: Session, walked: Walk) -> Iterator[tuple[str, str]]:
    apart = walked.observed_W - walked.predicted_W
    i = int(np.argmax(np.abs(apart)))
    yield "V, first and last", f"{_J(walked.V_J[0])}, {_J(walked.V_J[-1])}"
    yield "supplied by u_A', by the person", f"{_J(walked.guidance_J[-1])}, {_J(walked.person_J[-1])}"
    yield "dissipated", _J(walked.dissipated_J[-1])
    yield "unexplained rise of V", _J(walked.unexplained_J[-1])
    fall, at_s = worst(walked.t_s, -walked.unexplained_J)
    yield "  its worst over any stretch", f"{_J(fall)} {_when(session, at_s)}"
    yield "rate, RMS, predicted", f"{metrics.rms(walked.predicted_W):.3f} W"
    yield "  observed less predicted", f"{metrics.rms(apart):.3f} W"
    yield "  largest", f"{apart[i]:+.3f} W {_when(session, float(walked.t_s[i]))}"


def _verdict(session: Session) -> Iterator[Text]:
    books = session.table(ENERGY)
    if session.damage:
        yield Text(f"the recording is damaged: {session.damage}", style="yellow")
    if not len(books["t_s"]):
        yield Text("no energy/balance in this recording", style="yellow")
        return
    low, least = int(np.argmin(books["tank_J"])), float(np.min(books["tank_scale"]))
    when = _when(session, float(books["t_s"][low]))
    yield Text(f"tank: lowest {books['tank_J'][low]:.2f} J {when}; at least {least:.0%} of the guidance acted")
    made = _made_J(session)
    if made > ROUNDING_J:
        yield Text(f"the filter made {made:.2g} J out of nothing", style="bold red")
    else:
        yield Text("the filter was passive at its port throughout", style="bold green")


def _table(*columns: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    for i, column in enumerate(columns):
        table.add_column(column, justify="right" if i else "left")
    return table


def _made_J(session: Session) -> float:
    return float(np.max(session.table(ENERGY)["created_J"], initial=0.0))


def _last_J(books: Books, name: str) -> str:
    return _J(getattr(books.balance, name)[-1]) if len(books.t_s) else UNKNOWN


def _fall(session: Session, books: Books) -> tuple[str, str]:
    """By how much the residual fell, which it should not have, and when."""
    if not len(books.t_s):
        return UNKNOWN, ""
    fall, at_s = worst(books.t_s, books.balance.residual_J)
    return (_J(fall), _when(session, at_s)) if fall > TOLD_J else ("none", "")


def _when(session: Session, at_s: float) -> str:
    phase = next((p.phase.value for p in session.phases if p.start_s <= at_s < p.end_s), "no phase")
    return f"at {at_s:.1f} s ({phase})"


def _J(energy: float) -> str:
    return f"{energy:.3f} J".replace("-0.000", "0.000")


def _plain(error: OSError | ValueError) -> str:
    return f"{error.filename}: {error.strerror}" if isinstance(error, OSError) and error.filename else str(error)
