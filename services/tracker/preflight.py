"""What stands against a flight on the side of motion capture: an ordered list, each with its cure. Pure.

It looks at a few seconds of frames with vehicle and handle lying where the flight begins. The order is that in which to
mend them: the connection, the bodies, how often and how regularly they come, and the axes.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from services.physics import Array
from services.tracker import axes
from services.tracker.bodies import CaptureSystem

Flags: TypeAlias = NDArray[np.bool_]

SEEN_LEAST = 0.99
"""Of all frames, those in which a body must be seen."""
GAP_S = 0.1
"""Longer than this the tracker coasts on what it last saw, and supervision eases after twice as much."""
LATE_S = 0.02
"""An arrival so much later than the fastest ones is a network that is not the capture system's alone."""


class Frames(NamedTuple):
    """What was seen in `lasted_s`, (N,) each: stamps and how long after them the frames arrived in s, which body was tracked,
    positions robot first (N, 2, 3), the robot's attitude (N, 4); and what the capture system's client complained of."""

    lasted_s: float
    stamp_s: Array
    late_s: Array
    robot: Flags
    handle: Flags
    position_m: Array
    q_WB_wxyz: Array
    trouble: str


class Check(NamedTuple):
    """One line of the table: its name, what is found to be wrong (empty: nothing), and the cure."""

    name: str
    look: Callable[[Frames, CaptureSystem, axes.Axes], str]
    cure: str


def _connected(f: Frames, _: CaptureSystem, __: axes.Axes) -> str:
    return "" if len(f.stamp_s) > 1 else f.trouble or "no frames of motion capture"


def _named(f: Frames, _: CaptureSystem, __: axes.Axes) -> str:
    return f.trouble if len(f.stamp_s) > 1 else ""


def _seen(f: Frames, p: CaptureSystem, _: axes.Axes) -> str:
    if f.trouble or len(f.stamp_s) < 2:
        return ""
    shares = {p.robot.body: float(np.mean(f.robot)), p.handle.body: float(np.mean(f.handle))}
    return ", ".join(
        f"{name} is seen in {share:.1%} of the frames" for name, share in shares.items() if share < SEEN_LEAST
    )


def _often(f: Frames, p: CaptureSystem, _: axes.Axes) -> str:
    if len(f.stamp_s) < 2:
        return ""
    rate_Hz = len(f.stamp_s) / f.lasted_s
    band = f"{p.rate_min_Hz:g} to {p.rate_max_Hz:g} Hz"
    return (
        "" if p.rate_min_Hz <= rate_Hz <= p.rate_max_Hz else f"{rate_Hz:.0f} frames a second, the profile wants {band}"
    )


def _regular(f: Frames, _: CaptureSystem, __: axes.Axes) -> str:
    gap_s = float(np.max(np.diff(f.stamp_s), initial=0.0))
    return f"{gap_s:.2f} s without a frame" if gap_s > GAP_S else ""


def _early(f: Frames, _: CaptureSystem, __: axes.Axes) -> str:
    late_s = float(np.quantile(f.late_s, 0.99)) if len(f.late_s) else 0.0
    return f"one frame in a hundred arrives {1000 * late_s:.0f} ms late" if late_s > LATE_S else ""


def _upright(f: Frames, _: CaptureSystem, p: axes.Axes) -> str:
    state, last_s = axes.start(), 0.0
    for i in np.flatnonzero(f.robot & f.handle):
        state = axes.step(state, f.position_m[i], f.q_WB_wxyz[i], float(f.stamp_s[i]) - last_s, p)
        last_s = float(f.stamp_s[i])
    if state.verdict is axes.Verdict.UNKNOWN and np.any(f.robot & f.handle):
        return "robot and handle do not lie still on the floor z = 0: which way is up cannot be told"
    return axes.complaint(state)


CHECKS: tuple[Check, ...] = (
    Check("connection", _connected, "is it on, streaming, reachable, and where tracker.mocap.host says?"),
    Check("bodies", _named, "enter its name in tracker.mocap.*.body; a body that is hidden from all cameras has none"),
    Check("visibility", _seen, "more cameras, more markers, no reflections, nothing in the way"),
    Check("rate", _often, "set the capture system's rate, or tracker.mocap.rate_min_Hz and rate_max_Hz"),
    Check("gaps", _regular, "a network of its own for the capture system, by cable"),
    Check("lateness", _early, "a network of its own for the capture system, by cable"),
    Check("axes", _upright, "put both where the flight begins; z up in the capture system, its origin on the floor"),
)  # fmt: skip


def reasons(frames: Frames, p: CaptureSystem, world: axes.Axes) -> list[tuple[str, str]]:
    """Everything that stands against a flight, what and cure; empty is good."""
    found = ((check.look(frames, p, world), check.cure) for check in CHECKS)
    return [(what, cure) for what, cure in found if what]
