# pyright: reportUnknownMemberType=false
# matplotlib's stubs leave keyword arguments open
"""How old set-points were, and how long the hand's motion took to reach them."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from schemas.topics import SETPOINT
from services.physics import Array
from services.recorder.colours import BLACK, BLUE, ORANGE, RED
from services.recorder.latency import reactions
from services.recorder.reading import Session


def timing_figure(session: Session) -> Figure:
    """Age of each set-point and time between them, on the left; delay from capture to set-point, on the right."""
    figure = Figure(figsize=(7.0, 2.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    sent = session.table(SETPOINT)
    left.plot(
        sent["t_s"][1:], 1e3 * np.diff(sent["t_s"]), ".", color=ORANGE, markersize=1.5, label="since the last one"
    )
    left.plot(sent["t_s"], 1e3 * sent["age_s"], ".", color=BLUE, markersize=1.5, label="age of its sample")
    left.set(xlabel="time (s)", ylabel="set-point (ms)", ylim=(0.0, None))
    left.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, markerscale=5, handletextpad=0.2)
    _draw_histogram(right, 1e3 * reactions(session).get("total", np.zeros(0)))
    return figure


def _draw_histogram(axes: Axes, delay_ms: Array) -> None:
    axes.set(xlabel="from capture to set-point (ms)", ylabel="handle samples")
    if not len(delay_ms):
        return
    p50, p99 = np.percentile(delay_ms, (50, 99))
    axes.hist(delay_ms, bins=40, range=(0.0, 1.3 * float(p99)), color=BLUE, alpha=0.85)
    axes.axvline(float(p50), color=BLACK, linewidth=1.0, label=f"median {p50:.1f} ms")
    axes.axvline(float(p99), color=RED, linewidth=1.0, linestyle="--", label=f"99 % within {p99:.1f} ms")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, handlelength=1.4, columnspacing=1.0)
