# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# matplotlib's stubs leave keyword arguments open
"""The paper's figures over all walks: where everybody went, and the path error of every run with its mean."""

from collections.abc import Callable
from pathlib import Path as File

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MultipleLocator

from services.campaign.statistics import PAPER_MEAN_M, STATIONS, Common, Result, common
from services.physics import Array
from services.recorder.colours import BLACK, BLUE, GREEN, GREY, ORANGE
from services.recorder.figure_path import draw_path
from services.recorder.figures import STYLE

FEW = 24
"""Up to so many walks each has a colour of its own."""
DRAWN = 1000
_HUES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#F0E442", "#999999")
_SHOWN = ("m_H_kg", "b_H_Ns_per_m", "reaction", "pull_threshold_N", "veer", "start_aside_m")


def draw_all(result: Result, folder: File) -> list[File]:
    """Write the figures into `folder`; returns the files."""
    drawings: dict[str, Callable[[Result, Common], Figure]] = {"walks.png": walks_figure}
    if len(_varying(result)) and len(result.errors) > FEW:
        drawings["people.png"] = people_figure
    shared = common(result.errors)
    with rc_context(STYLE):
        for name, draw in drawings.items():
            draw(result, shared).savefig(folder / name)
    return [folder / name for name in drawings]


def walks_figure(result: Result, shared: Common) -> Figure:
    """Above the x-y plane, below the path error over s: every run, the mean, and between which everybody stays."""
    width_m, height_m = np.ptp(result.path.samples_m, axis=0) + 2.0 * shared.tube_m
    plane = float(np.clip(6.2 * height_m / width_m, 1.6, 6.0))
    figure = Figure(figsize=(7.0, plane + 3.4), layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=(plane, 2.4))
    _draw_plane(above, result, shared)
    _draw_errors(below, result, shared)
    figure.legend(handles=_legend(result), loc="outside upper center", ncols=4, columnspacing=1.6, handlelength=2.2)
    return figure


def _draw_plane(axes: Axes, result: Result, shared: Common) -> None:
    path = result.path
    s = STATIONS
    tube = 0.5 * shared.tube_m
    left, right = ((path.p(s) + sign * tube * path.normal(s))[:, :2] for sign in (1.0, -1.0))
    axes.fill(*np.concatenate((left, right[::-1])).T, facecolor="#eef3f7", edgecolor="none", zorder=0)
    draw_path(axes, path)
    _draw_lines(axes, [np.asarray(trace) for trace in result.traces], result)
    known = np.isfinite(shared.mean_m)
    mean = path.p(s) + np.nan_to_num(shared.mean_m)[:, None] * path.normal(s)
    axes.plot(*mean[known, :2].T, color=BLACK, linewidth=2.2, zorder=6)
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    axes.yaxis.set_major_locator(MultipleLocator(0.5))
    axes.margins(0.03, 0.06)


def _draw_errors(axes: Axes, result: Result, shared: Common) -> None:
    s, cm = STATIONS, 100.0
    lines = [np.column_stack((s, cm * error)) for error in result.errors[:DRAWN]]
    _draw_lines(axes, lines, result)
    axes.fill_between(
        s, cm * (shared.mean_m - shared.std_m), cm * (shared.mean_m + shared.std_m), color=GREY, alpha=0.35, linewidth=0
    )
    axes.plot(s, cm * shared.low_m, color=BLUE, linewidth=0.8, linestyle=(0, (2, 1.5)))
    axes.plot(s, cm * shared.high_m, color=BLUE, linewidth=0.8, linestyle=(0, (2, 1.5)))
    axes.plot(s, cm * shared.mean_m, color=BLACK, linewidth=2.2, zorder=6)
    for limit in (-cm * PAPER_MEAN_M, cm * PAPER_MEAN_M):
        axes.axhline(limit, color=ORANGE, linewidth=1.0, linestyle=(0, (1, 1.5)), zorder=5)
    top = 1.08 * max(cm * 0.5 * shared.tube_m, 6.0)
    axes.set(xlim=(0.0, 1.0), ylim=(-top, top), xlabel="s", ylabel="path error, left positive (cm)")


def _draw_lines(axes: Axes, lines: list[Array], result: Result) -> None:
    few = len(result.errors) <= FEW
    colours = [_HUES[int(person - 1) % len(_HUES)] for person in result.columns["person"][: len(lines)]]
    axes.add_collection(
        LineCollection(
            lines,
            colors=colours if few else GREEN,
            linewidths=1.0 if few else 0.5,
            alpha=0.9 if few else max(0.04, min(0.5, 20.0 / len(lines))),
            zorder=3,
        )
    )
    axes.autoscale_view()


def _legend(result: Result) -> list[Line2D | Patch]:
    few = len(result.errors) <= FEW
    return [
        Line2D([], [], color=BLACK, linestyle=(0, (4, 3)), linewidth=1.0, label="desired"),
        Line2D(
            [],
            [],
            color=BLUE if few else GREEN,
            linewidth=1.0,
            label=f"{len(result.errors)} walks" + (", coloured by person" if few else ""),
        ),
        Line2D([], [], color=BLACK, linewidth=2.2, label="mean"),
        Patch(facecolor=GREY, alpha=0.35, label="mean ± std"),
        Patch(facecolor="#eef3f7", edgecolor="#c9d6e0", label="tube that holds everyone"),
        Line2D([], [], color=BLUE, linewidth=0.8, linestyle=(0, (2, 1.5)), label="outermost at s"),
        Line2D([], [], color=ORANGE, linewidth=1.0, linestyle=(0, (1, 1.5)), label="5 cm, the paper's mean"),
    ]


def people_figure(result: Result, _: Common) -> Figure:
    """Each walk's mean error and time against what varies."""
    names = _varying(result)
    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    panels = figure.subplots(2, len(names), sharey="row", squeeze=False)
    rows = (("error_mean_m", 100.0, "mean error (cm)"), ("arrival_s", 1.0, "arrival (s)"))
    for row, (name, factor, label) in zip(panels, rows, strict=True):
        row[0].set_ylabel(label)
        for axes, column in zip(row, names, strict=True):
            x, y = result.columns[column], factor * result.columns[name]
            axes.plot(
                x, y, ".", color=GREEN, markersize=2.5, alpha=max(0.1, min(0.7, 300.0 / len(x))), markeredgewidth=0
            )
            _draw_median(axes, x, y)
    for axes, column in zip(panels[-1], names, strict=True):
        axes.set_xlabel(column)
    return figure


def _draw_median(axes: Axes, x: Array, y: Array) -> None:
    """The median of y in ten parts of x, where there are enough."""
    known = np.isfinite(x) & np.isfinite(y)
    if np.count_nonzero(known) < 50 or len(np.unique(x)) < 10:
        return
    parts = np.array_split(np.argsort(x[known]), 10)
    axes.plot([np.median(x[known][part]) for part in parts], [np.median(y[known][part]) for part in parts], color=BLACK)


def _varying(result: Result) -> list[str]:
    """The columns worth a panel, at most six: what was varied on purpose, then what differs of the people."""
    names = [name for name in (*result.varied, *_SHOWN) if name in result.columns]
    return [name for name in dict.fromkeys(names) if len(np.unique(result.columns[name])) > 1][:6]
