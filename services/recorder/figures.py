# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# matplotlib's stubs leave keyword arguments open
"""The paper's single-subject figures of a recorded session, and one of timing: PNG files, for print and screen."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from services.recorder.figure_energy import energy_figure
from services.recorder.figure_path import path_figure
from services.recorder.figure_time import time_figure
from services.recorder.figure_timing import timing_figure
from services.recorder.reading import Session

FIGURES: dict[str, Callable[[Session], Figure]] = {
    "path.png": path_figure,
    "time.png": time_figure,
    "energy.png": energy_figure,
    "timing.png": timing_figure,
}

STYLE: dict[Any, Any] = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.linewidth": 0.4,
    "grid.color": "#dddddd",
    "axes.axisbelow": True,
    "lines.linewidth": 1.1,
    "lines.solid_capstyle": "round",
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "savefig.dpi": 250,
}


def draw_all(session: Session, folder: Path, suffix: str = ".png") -> list[Path]:
    """Write every figure into `folder`, whatever the recording holds; returns the files."""
    return [draw(name, session, folder, suffix) for name in FIGURES]


def draw(name: str, session: Session, folder: Path, suffix: str = ".png") -> Path:
    """Write one of `FIGURES` into `folder`; returns the file."""
    folder.mkdir(parents=True, exist_ok=True)
    file = (folder / name).with_suffix(suffix)
    with rc_context(STYLE):
        FIGURES[name](session).savefig(file)
    return file
