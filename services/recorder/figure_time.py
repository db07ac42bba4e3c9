# pyright: reportUnknownMemberType=false
# matplotlib's stubs leave keyword arguments open
"""The session against time: the hand's error, the hand, the robot and the cable force, phase by phase."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from schemas.safety import Phase
from schemas.topics import CABLE_FORCE, GUIDANCE
from services.guiding_controller.path import Path, project
from services.physics import Array, norm
from services.recorder.colours import BLACK, GREY, SHADE, XYZ
from services.recorder.reading import Interval, Session
from services.recorder.walk import Motion, guided, motion, path_of, valid, within

DASHES = (0, (4, 2))
_NARROW = 0.1  # a phase shorter than this part of the session has its name aslant
_APART = 0.027


def time_figure(session: Session) -> Figure:
    """Four panels over one axis of time, s since the session's start."""
    figure = Figure(figsize=(7.0, 7.2), layout="constrained")
    panels: Sequence[Axes] = figure.subplots(4, 1, sharex=True)
    error, hand, robot, force = panels
    moved, spans = motion(session), guided(session)
    _draw_error(error, moved, path_of(session), spans)
    _draw_hand(hand, session, moved)
    _draw_vector(robot, moved.t_s, moved.p_R)
    robot.set_ylabel("robot (m)")
    _draw_force(force, session, moved)
    force.set(xlabel="time (s)", xlim=(0.0, max(session.duration_s, 1.0)))
    for panel in panels:
        shade(panel, session.phases)
    name_phases(error, session)
    figure.align_ylabels(panels)
    return figure


def _draw_error(axes: Axes, moved: Motion, path: Path | None, spans: list[Interval]) -> None:
    """e_H = p_H^d(s*) - p_H. The scale is phase 2's: before and after it, the handle swings out of the frame."""
    axes.set_ylabel(r"hand error $e_H$ (cm)")
    if path is None or not len(moved.t_s):
        return
    error = 100.0 * (path.p(project(moved.p_H, path)) - moved.p_H)
    walking = moved.during(spans)
    _draw_vector(axes, moved.t_s, error, names="xy")
    axes.plot(moved.t_s, norm(error[:, :2]), color=BLACK, linewidth=1.4, label=r"$\|e_H\|$")
    top = max(1.15 * float(np.max(norm(error[walking][:, :2]), initial=0.0)), 5.5)
    axes.set_ylim(-top, top)
    axes.axhline(5.0, color=GREY, linewidth=0.8, linestyle=(0, (1, 2)), label="5 cm")
    legend(axes)


def _draw_hand(axes: Axes, session: Session, moved: Motion) -> None:
    wanted = valid(session.table(GUIDANCE))
    _draw_vector(axes, moved.t_s, moved.p_H)
    _draw_vector(axes, wanted["t_s"], wanted["p_H_d_m"], dashed=True, colour=BLACK)  # it lies on the actual one
    axes.set_ylabel("hand (m)")


def _draw_force(axes: Axes, session: Session, moved: Motion) -> None:
    wanted, seen = valid(session.table(GUIDANCE)), valid(session.table(CABLE_FORCE))
    _draw_vector(axes, seen["t_s"], seen["force_N"])
    _draw_vector(axes, wanted["t_s"], wanted["f_d_N"], dashed=True)
    if moved.from_truth:
        axes.plot(moved.t_s, moved.f_c, color=BLACK, linewidth=0.4, alpha=0.8)
        axes.plot([], [], color=BLACK, linewidth=0.4, label="true")
        legend(axes)
    flown = [span for span in session.phases if span.phase in (Phase.READY, Phase.GUIDING, Phase.ARRIVED)]
    pull = seen["force_N"][within(seen["t_s"], flown)]
    if len(pull):  # on the ground the observer sees the floor, which would shrink all else
        axes.set_ylim(float(np.min(pull)) - 0.5, float(np.max(pull)) + 0.5)
    axes.set_ylabel(r"cable force $f_c$ (N)")


def _draw_vector(
    axes: Axes, t_s: Array, v: Array, *, names: str = "xyz", dashed: bool = False, colour: str = ""
) -> None:
    """One line per component: solid and named, or dashed for what was desired. Gaps in time stay gaps."""
    gaps = np.flatnonzero(np.diff(t_s) > 0.5) + 1
    t_s, v = np.insert(t_s, gaps, np.nan), np.insert(v, gaps, np.nan, axis=0)
    for i, name in enumerate(names):
        if dashed:
            axes.plot(t_s, v[:, i], color=colour or XYZ[name], linestyle=DASHES, linewidth=0.9)
        else:
            axes.plot(t_s, v[:, i], color=XYZ[name], label=name)
    if dashed:
        axes.plot([], [], color=colour or GREY, linestyle=DASHES, linewidth=0.9, label="desired")
    legend(axes)


def legend(axes: Axes) -> None:
    """Beside the panel."""
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), handlelength=1.6)


def shade(axes: Axes, phases: list[Interval]) -> None:
    """Every other phase."""
    for i, (_, start_s, end_s) in enumerate(phases):
        if i % 2:
            axes.axvspan(start_s, end_s, color=SHADE, linewidth=0, zorder=0)


def name_phases(axes: Axes, session: Session) -> None:
    """Above the panel; names of short phases are moved apart, so that each can be read."""
    free_s = 0.0
    for phase, start_s, end_s in session.phases:
        aslant = end_s - start_s < _NARROW * session.duration_s
        at_s = max((start_s + end_s) / 2, free_s)
        free_s = at_s + _APART * session.duration_s
        axes.annotate(
            phase.value,
            (at_s, 1.03),
            xycoords=("data", "axes fraction"),
            ha="left" if aslant else "center",
            va="bottom",
            rotation=55 if aslant else 0,
            rotation_mode="anchor",
            color="#333333",
        )
