# pyright: reportUnknownMemberType=false
# matplotlib's stubs leave keyword arguments open
"""The walk from above: desired and actual path of the hand, and at four instants drone, cable, u_A and f_c."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import ArrowStyle, Circle, FancyArrowPatch
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from schemas.topics import GUIDANCE
from services.guiding_controller.path import Path, project
from services.physics import Array
from services.recorder.colours import BLACK, BLUE, GREEN, GREY, ORANGE, RED
from services.recorder.reading import Session
from services.recorder.walk import Motion, at, guided, motion, path_of, valid

INSTANTS = (0.04, 0.36, 0.64, 0.93)
"""s at which the system is drawn."""
METRES_PER_NEWTON = 0.3
_LONG_ENOUGH_M = 0.03  # an arrow shorter than its head says nothing


def path_figure(session: Session) -> Figure:
    """Phase 2 in the x-y plane, as far as the recording tells."""
    figure = Figure(figsize=(7.0, 2.8), layout="constrained")
    axes = figure.add_subplot(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    moved, path = motion(session), path_of(session)
    walking = moved.during(guided(session))
    if path is not None:
        draw_path(axes, path)
    axes.plot(*moved.p_R[walking, :2].T, color=BLUE, linewidth=0.7, alpha=0.45, zorder=2)
    axes.plot(*moved.p_H[walking, :2].T, color=GREEN, linewidth=1.8, zorder=3)
    if path is not None and np.any(walking):
        _draw_instants(axes, session, moved, path, walking)
    axes.margins(0.04, 0.14)
    axes.yaxis.set_major_locator(MultipleLocator(0.5))
    _draw_scale(axes)
    figure.legend(handles=_legend(), loc="outside upper center", ncols=4, columnspacing=1.6, handlelength=2.2)
    return figure


def draw_path(axes: Axes, path: Path) -> None:
    """The desired path of the hand, and the posts."""
    axes.plot(*path.p(np.linspace(0.0, 1.0, 301))[:, :2].T, color=BLACK, linestyle=(0, (4, 3)), linewidth=1.0, zorder=4)
    for post in path.obstacles:
        axes.add_patch(Circle((post.x_m, post.y_m), post.radius_m, facecolor="#d9d9d9", edgecolor=GREY, hatch="////"))
        axes.annotate("post", (post.x_m, post.y_m - post.radius_m - 0.04), ha="center", va="top", color="#555555")


def _draw_instants(axes: Axes, session: Session, moved: Motion, path: Path, walking: NDArray[np.bool_]) -> None:
    t_s, p_H = moved.t_s[walking], moved.p_H[walking]
    s = project(p_H, path)
    guidance = valid(session.table(GUIDANCE))
    for wanted in INSTANTS:
        if s[-1] < wanted:
            continue
        i = int(np.argmax(s >= wanted))
        p_R, f_c = moved.p_R[walking][i], moved.f_c[walking][i]
        u_A = at(guidance, "u_A_N", t_s[i : i + 1])[0] if len(guidance["t_s"]) else np.zeros(3)
        axes.plot(*np.stack((p_H[i], p_R))[:, :2].T, color=BLACK, linewidth=1.0, zorder=6)
        _draw_arrow(axes, p_H[i], f_c, ORANGE, 5)
        _draw_arrow(axes, p_R, u_A, RED, 7)
        axes.plot(*p_R[:2], "o", color=BLUE, markersize=9, markeredgecolor="white", zorder=8)
        axes.plot(*p_H[i, :2], "o", color=GREEN, markersize=6.5, markeredgecolor="white", zorder=8)
        _label_instant(axes, p_H[i], f"{t_s[i] - t_s[0]:.0f} s")


def _draw_arrow(axes: Axes, start: Array, force: Array, colour: str, order: int) -> None:
    tip = start[:2] + METRES_PER_NEWTON * force[:2]
    if np.hypot(*(tip - start[:2])) > _LONG_ENOUGH_M:
        axes.add_patch(_arrow(start, tip, colour, order))
        axes.update_datalim([(float(tip[0]), float(tip[1]))])


def _arrow(start: Array, tip: Array, colour: str, order: int) -> FancyArrowPatch:
    head = ArrowStyle("-|>", head_length=0.45, head_width=0.28)
    ends = (float(start[0]), float(start[1])), (float(tip[0]), float(tip[1]))
    return FancyArrowPatch(
        *ends, color=colour, zorder=order, arrowstyle=head, mutation_scale=10, shrinkA=0, shrinkB=0, linewidth=2.2
    )


def _draw_scale(axes: Axes) -> None:
    """How long an arrow of 1 N is, in the corner that the path leaves free."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    tip = np.array((right - 0.02 * (right - left), low + 0.1 * (high - low)))
    start = tip - (METRES_PER_NEWTON, 0.0)
    axes.add_patch(_arrow(start, tip, GREY, 5))
    axes.annotate("1 N ", (float(start[0]), float(start[1])), ha="right", va="center", color="#555555")


def _label_instant(axes: Axes, p_H: Array, text: str) -> None:
    x, y = float(p_H[0]), float(p_H[1])
    axes.annotate(text, (x, y), xytext=(0, -9), textcoords="offset points", ha="center", va="top", color="#333333")


def _legend() -> list[Line2D]:
    return [
        Line2D([], [], color=BLACK, linestyle=(0, (4, 3)), label="hand, desired"),
        Line2D([], [], color=GREEN, linewidth=1.8, label="hand, actual"),
        Line2D([], [], color=BLUE, linewidth=0.7, alpha=0.6, label="drone, actual"),
        Line2D([], [], color=BLACK, linewidth=1.0, label="cable"),
        Line2D([], [], color=BLUE, linestyle="none", marker="o", markersize=8, label="drone"),
        Line2D([], [], color=GREEN, linestyle="none", marker="o", markersize=6, label="hand"),
        Line2D([], [], color=RED, linewidth=2.4, label=r"$u_A$, x-y part"),
        Line2D([], [], color=ORANGE, linewidth=2.4, label=r"$f_c$, x-y part"),
    ]
