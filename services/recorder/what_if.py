# pyright: reportUnknownMemberType=false
# matplotlib's stubs leave keyword arguments open
"""What was recorded and what the present code, or another parameter, makes of the same inputs, in one picture."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from schemas.topics import BY_KEY
from services.recorder.colours import BLACK, RED
from services.recorder.reading import Session
from services.recorder.rerun import Outcome
from services.recorder.table import Array, rows, table

_MOST = 8
_HEADER = ("seq", "stamp_ns", "said_ns", "t_s")


class Curves(NamedTuple):
    """One number of a topic over time, as recorded and as it would have been."""

    name: str
    t_s: Array
    recorded: Array
    said: Array

    @property
    def departure(self) -> float:
        """Largest difference as a share of what was recorded; what was constant counts in its own unit."""
        span = float(np.ptp(self.recorded)) or 1.0
        return float(np.max(np.abs(self.said - self.recorded), initial=0.0)) / span


def draw(session: Session, outcomes: Sequence[Outcome], file: Path) -> Path | None:
    """The numbers that differ most, at most 8; None where none differs."""
    differing = [curve for outcome in outcomes for curve in curves(session, outcome) if curve.departure > 0.0]
    chosen = sorted(differing, key=lambda curve: -curve.departure)[:_MOST]
    if not chosen:
        return None
    figure = Figure(figsize=(8.0, 1.6 * len(chosen) + 0.4), layout="constrained")
    for axes, curve in zip(figure.subplots(len(chosen), 1, sharex=True, squeeze=False)[:, 0], chosen, strict=True):
        axes.plot(curve.t_s, curve.recorded, color=BLACK, linewidth=1.0, label="recorded")
        axes.plot(curve.t_s, curve.said, color=RED, linewidth=1.0, linestyle="--", label="now")
        axes.set_ylabel(curve.name.replace(" ", "\n"), fontsize=7)
        axes.legend(loc="upper right", fontsize=7)
    figure.axes[-1].set_xlabel("time (s)")
    figure.savefig(file, dpi=110)
    return file


def curves(session: Session, outcome: Outcome) -> Iterator[Curves]:
    """Every number of every topic that came out in the same count."""
    for key, payloads in outcome.said.items():
        recorded, said = session.table(key), table(BY_KEY[key].type, rows(payloads))
        if len(recorded["seq"]) != len(said["seq"]):
            continue
        for name, column in recorded.items():
            if name in said and name not in _HEADER and not name.startswith("inputs") and column.dtype == np.float64:
                yield from _components(f"{key} {name}", recorded["t_s"], column, said[name])


def _components(name: str, t_s: Array, recorded: Array, said: Array) -> Iterator[Curves]:
    if recorded.ndim == 1:
        yield Curves(name, t_s, recorded, said)
        return
    for i, axis in enumerate("xyz" if recorded.shape[1] == 3 else "wxyz"):
        yield Curves(f"{name}.{axis}", t_s, recorded[:, i], said[:, i])
