"""What an operator watches: phase, progress, force on the hand, and the health of every service.

`render` draws a View for a terminal, `line` says it in one line where there is none. Both show a dash for what is not
known or not fresh: an old number is never shown as if it were new.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from rich import box
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from schemas.estimation import CableForce
from schemas.guidance import GuidanceCommand
from schemas.health import Heartbeat
from schemas.message import Vec3
from schemas.safety import Level, SafetyState
from schemas.simulation import Truth
from schemas.topics import CABLE_FORCE, GUIDANCE, HEALTH, SAFETY_STATE, SETPOINT, TRUTH
from services.runtime.node import Node

UNKNOWN = "–"
_COLOUR = {
    Level.OK: "green",
    Level.WARN: "yellow",
    Level.EASE: "dark_orange",
    Level.HOLD: "dark_orange",
    Level.LAND: "red",
    Level.DESCEND: "red",
    Level.KILL: "bold red",
}


@dataclass(frozen=True)
class View:
    """One moment; None for what is not fresh. `services` names those that are expected to run."""

    elapsed_s: float = 0.0
    safety: SafetyState | None = None
    guidance: GuidanceCommand | None = None
    force: CableForce | None = None
    truth: Truth | None = None
    setpoint_age_s: float | None = None
    services: Mapping[str, Heartbeat | None] = field(default_factory=dict[str, Heartbeat | None])
    footer: str = ""
    """What the keys do, or what came of the last one."""

    @property
    def hand_force_N(self) -> float | None:
        """‖force on the hand‖: the simulator's, else the estimated pull of the cable while the handle is held."""
        if self.truth is not None:
            return _length(self.truth.hand_force_N)
        if self.force is None or self.safety is None:
            return None
        return _length(self.force.force_N) if self.safety.held else 0.0


class Watch:
    """Reads what a view shows; `node` is an observer."""

    def __init__(self, node: Node, services: tuple[str, ...] = tuple(HEALTH)) -> None:
        self._clock = node.clock
        self._start_ns = node.clock.now_ns()
        self._safety = node.latest(SAFETY_STATE)
        self._guidance = node.latest(GUIDANCE)
        self._force = node.latest(CABLE_FORCE)
        self._truth = node.latest(TRUTH)
        self._setpoint = node.latest(SETPOINT)
        self._health = {name: node.latest(HEALTH[name]) for name in services}
        self.footer = ""

    def view(self) -> View:
        """This moment."""
        return View(
            elapsed_s=(self._clock.now_ns() - self._start_ns) * 1e-9,
            safety=self._safety.value,
            guidance=self._guidance.value,
            force=self._force.value,
            truth=self._truth.value,
            setpoint_age_s=self._setpoint.age_s if self._setpoint.message else None,
            services={name: latest.value for name, latest in self._health.items()},
            footer=self.footer,
        )


def render(view: View) -> RenderableType:
    """The panel; for terminals of 80 columns and more."""
    parts = [_headline(view), _progress(view.guidance), _numbers(view), _services(view)]
    reasons = [
        Text(f"• {reason}", style=_colour(view.safety)) for reason in (view.safety.reasons if view.safety else ())
    ]
    return Panel(
        Group(*parts, *reasons),
        title="clew",
        subtitle=view.footer or None,
        box=box.ROUNDED,
        border_style=_colour(view.safety),
    )


def line(view: View) -> str:
    """The same in one line of plain text."""
    silent = [name for name, beat in view.services.items() if beat is None]
    words = [
        f"{view.elapsed_s:6.1f} s",
        f"{view.safety.phase} {view.safety.level.name.lower()}" if view.safety else "no word from the supervisor",
        f"path {_percent(view.guidance)}",
        f"error {_error(view.guidance)}",
        f"hand {_newtons(view.hand_force_N)}",
        f"set-point {_age(view.setpoint_age_s)}",
        *([f"silent: {', '.join(silent)}"] if silent else []),
        *(view.safety.reasons[:1] if view.safety else []),
    ]
    return "  ".join(words)


def _headline(view: View) -> RenderableType:
    safety = view.safety
    row = Table.grid(expand=True)
    row.add_column()
    row.add_column(justify="right")
    if safety is None:
        row.add_row(Text("no word from the supervisor", style="bold red"), f"{view.elapsed_s:.0f} s")
        return row
    phase = Text.assemble(
        (safety.phase.upper(), f"bold {_colour(safety)}"),
        (f"  {safety.level.name.lower()}, bridge may: {safety.permit}", _colour(safety)),
    )
    row.add_row(phase, f"handle {'held' if safety.held else 'free'}   {view.elapsed_s:.0f} s")
    return row


def _progress(guidance: GuidanceCommand | None) -> RenderableType:
    row = Table.grid(padding=(0, 1), expand=True)
    row.add_column(width=4)
    row.add_column(ratio=1)
    row.add_column(justify="right", no_wrap=True)
    bar = ProgressBar(total=1.0, completed=guidance.s if guidance else 0.0)
    row.add_row("path", bar, f"{_percent(guidance)} of {guidance.path_length_m:.2f} m" if guidance else UNKNOWN)
    return row


def _numbers(view: View) -> RenderableType:
    row = Table.grid(padding=(0, 2), expand=True)
    for _ in range(3):
        row.add_column(justify="center", ratio=1)
    row.add_row("path error", "force on the hand", "set-point age", style="dim")
    row.add_row(_error(view.guidance), _newtons(view.hand_force_N), _age(view.setpoint_age_s), style="bold")
    return row


def _services(view: View) -> RenderableType:
    table = Table(box=box.SIMPLE_HEAD, expand=True, padding=(0, 1))
    table.add_column("service", no_wrap=True)
    for heading in ("Hz", "missed", "stall ms", "refused"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("status", ratio=1, no_wrap=True, overflow="ellipsis")
    for name, beat in view.services.items():
        table.add_row(*_service(name, beat))
    return table


def _service(name: str, beat: Heartbeat | None) -> tuple[RenderableType, ...]:
    if beat is None:
        return (Text(f"○ {name}", style="red"), *(UNKNOWN,) * 4, Text("silent", style="red"))
    return (
        Text(f"● {name}", style="green"),
        f"{beat.loop_rate_Hz:.0f}",
        f"{beat.missed_periods}",
        f"{beat.longest_stall_ms:.0f}",
        f"{sum(beat.rejected.values())}",
        Text(beat.status),
    )


def _colour(safety: SafetyState | None) -> str:
    return _COLOUR[safety.level] if safety else "red"


def _percent(guidance: GuidanceCommand | None) -> str:
    return f"{100 * guidance.s:.0f} %" if guidance else UNKNOWN


def _error(guidance: GuidanceCommand | None) -> str:
    if guidance is None:
        return UNKNOWN
    return f"{100 * abs(guidance.path_error_m):.1f} cm {'left' if guidance.path_error_m >= 0 else 'right'}"


def _newtons(force_N: float | None) -> str:
    return UNKNOWN if force_N is None else f"{force_N:.1f} N"


def _age(age_s: float | None) -> str:
    return UNKNOWN if age_s is None else f"{1e3 * age_s:.0f} ms" if age_s < 1.0 else f"{age_s:.1f} s"


def _length(v: Vec3) -> float:
    return float(np.sqrt(v.x * v.x + v.y * v.y + v.z * v.z))
