"""The end of a session on a terminal: the paper's numbers, what is allowed, and what was not as it should be."""

from collections.abc import Iterator
from pathlib import Path

from rich import box
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from services.recorder.numbers import BY_KEY
from services.recorder.summary import Check, Spread, Summary

Row = tuple[str, str, str]


def show(summary: Summary, folder: Path, console: Console) -> None:
    """Print the report, and where the session's files are."""
    console.print(report(summary))
    console.print(f"recording, figures and summary: {folder}", soft_wrap=True, highlight=False, markup=False)


def report(summary: Summary) -> RenderableType:
    """A table of numbers, the verdict below it."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    table.add_column("of this session")
    table.add_column("measured", justify="right")
    table.add_column("at most", justify="right")
    for check in summary.checks:
        table.add_row(*_checked(check), style="" if check.ok else "red")
    table.add_section()
    for row in _further(summary):
        table.add_row(*row)
    return Group(table, *_verdict(summary))


def _checked(check: Check) -> Row:
    _, name, factor, unit, _ = BY_KEY[check.name]
    return name, _quantity(check.value, factor, unit), _quantity(check.limit, factor, unit, ".3g")


def _further(summary: Summary) -> Iterator[Row]:
    yield "estimated force against the true one, RMS", _quantity(summary.force_error.rms_n, 1.0, "N", ".3f"), ""
    yield "robot against its reference, RMS", _quantity(summary.tracking_error.rms_m, 100.0, "cm"), ""
    yield "rotor to head, nearest", _quantity(summary.head_clearance_m, 1.0, "m"), ""
    yield "phase 2", _quantity(summary.durations_s.get("guiding"), 1.0, "s", ".1f"), ""
    yield "from the hand's capture to the set-point", _spread(summary.latency.get("total")), ""
    for stage, spread in summary.latency.items():
        if stage != "total":
            yield f"  {stage}", _spread(spread), ""
    yield "host stalls", str(summary.host_stalls), ""


def _verdict(summary: Summary) -> Iterator[Text]:
    seen = "the simulator's truth" if summary.from_truth else "the sensors"
    yield Text(f"{summary.messages} messages; positions and forces from {seen}", style="dim")
    for alarm in summary.alarms:
        yield Text(f"• {alarm}", style="yellow")
    yield Text("as it should be", style="bold green") if summary.ok else Text("not as it should be:", style="bold red")
    for reason in summary.reasons:
        yield Text(f"• {reason}", style="red")


def _spread(spread: Spread | None) -> str:
    return "unknown" if spread is None else f"{spread.p50_ms:.1f} ms (99 %: {spread.p99_ms:.1f})"


def _quantity(value: float | None, factor: float, unit: str, form: str = "") -> str:
    if value is None:
        return "unknown"
    return f"{value * factor:{form or ('.2f' if unit else '.0f')}} {unit}".rstrip()
