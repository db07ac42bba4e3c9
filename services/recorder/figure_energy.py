# pyright: reportUnknownMemberType=false
# matplotlib's stubs leave keyword arguments open
"""Energy against time: V and its rate in phase 2, what went through each port of the filter, and what does not add up."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from schemas.topics import ENERGY
from services.physics import Array
from services.recorder.colours import BLACK, BLUE, GREEN, GREY, ORANGE, RED
from services.recorder.figure_time import legend, name_phases, shade
from services.recorder.passivity import Books, Walk, filter_books, physical_books, walk
from services.recorder.reading import Session

PORTS = (
    ("guidance_J", "guidance", BLUE),
    ("cable_J", "cable", RED),
    ("height_J", "height", ORANGE),
    ("dissipated_J", "dissipated", GREEN),
)


def energy_figure(session: Session) -> Figure:
    """Four panels over one axis of time, s since the session's start; thin black is the simulator's truth."""
    figure = Figure(figsize=(7.0, 7.2), layout="constrained")
    panels: Sequence[Axes] = figure.subplots(4, 1, sharex=True)
    lyapunov, rate, ports, residual = panels
    walked, filtered, physical = walk(session), filter_books(session), physical_books(session)
    _draw_lyapunov(lyapunov, walked)
    _draw_rate(rate, walked)
    _draw_ports(ports, session, filtered, physical)
    _draw_residual(residual, walked, filtered, physical)
    residual.set(xlabel="time (s)", xlim=(0.0, max(session.duration_s, 1.0)))
    for panel in panels:
        shade(panel, session.phases)
    name_phases(lyapunov, session)
    figure.align_ylabels(panels)
    return figure


def _draw_lyapunov(axes: Axes, walked: Walk | None) -> None:
    axes.set_ylabel("$V$ and stored energy (J)")
    if walked is not None:
        _line(axes, walked.t_s, walked.V_J, "$V$", BLACK, 1.4)
        _line(axes, walked.t_s, walked.stored_J, "stored", GREEN)
        axes.set(yscale="log", ylim=(1e-4, None))
        legend(axes)


def _draw_rate(axes: Axes, walked: Walk | None) -> None:
    axes.set_ylabel(r"its rate $\dot V$ (W)")
    if walked is not None:
        _line(axes, walked.t_s, walked.observed_W, "observed", ORANGE, 2.0)
        _line(axes, walked.t_s, walked.predicted_W, "predicted", BLACK, 0.6)
        legend(axes)


def _draw_ports(axes: Axes, session: Session, filtered: Books, physical: Books) -> None:
    axes.set_ylabel("through the filter (J)")
    for name, label, colour in PORTS:
        _line(axes, filtered.t_s, getattr(filtered.balance, name), label, colour)
        _line(axes, physical.t_s, getattr(physical.balance, name), "", BLACK, 0.4)
    books = session.table(ENERGY)
    axes.plot(books["t_s"], books["tank_J"], color=GREY, linestyle=(0, (4, 2)), label="in the tank")
    if len(physical.t_s):
        axes.plot([], [], color=BLACK, linewidth=0.4, label="true")
    legend(axes)


def _draw_residual(axes: Axes, walked: Walk | None, filtered: Books, physical: Books) -> None:
    """A passive port's residual never falls; the walk's is what the predicted rate of V leaves, of either sign."""
    axes.set_ylabel("unaccounted for (J)")
    _line(axes, filtered.t_s, filtered.balance.residual_J, "filter", BLUE)
    _line(axes, physical.t_s, physical.balance.residual_J, "physical", BLACK, 0.8)
    if walked is not None:
        _line(axes, walked.t_s, -walked.unexplained_J, "of $V$", ORANGE)
    legend(axes)


def _line(axes: Axes, t_s: Array, y: Array, label: str, colour: str, width: float = 1.1) -> None:
    """Gaps in time stay gaps."""
    gaps = np.flatnonzero(np.diff(t_s) > 0.5) + 1
    t_s, y = np.insert(t_s, gaps, np.nan), np.insert(y, gaps, np.nan)
    axes.plot(t_s, y, color=colour, linewidth=width, label=label or "_")
