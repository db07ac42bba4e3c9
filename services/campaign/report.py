"""What a campaign leaves behind: runs.csv, errors.csv, traces.npz, summary.json, the figures, and one page with all of it."""

import base64
import csv
import html
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from services.campaign import figure
from services.campaign.population import Columns
from services.campaign.statistics import (
    PAPER_MEAN_M,
    PAPER_STD_M,
    PAPER_TUBE_M,
    STATIONS,
    Common,
    Result,
    common,
    persons,
)
from services.physics import Array

SHOWN_PERSONS = 40
TERMINAL_PERSONS, TERMINAL_COLUMNS = 12, 9
_MEASURED = {
    "error_mean_m": ("mean error", 100.0, "cm", 1),
    "error_max_m": ("largest", 100.0, "cm", 1),
    "outward_m": ("outward", 100.0, "cm", 1),
    "end_error_m": ("from the end", 100.0, "cm", 1),
    "arrival_s": ("arrival", 1.0, "s", 1),
    "slack_fraction": ("slack", 100.0, "%", 1),
    "force_max_N": ("max force", 1.0, "N", 2),
    "head_min_m": ("head to drone", 1.0, "m", 2),
}
_BODY = {"m_H_kg": ("m_H", 1.0, "kg", 1), "b_H_Ns_per_m": ("b_H", 1.0, "N s/m", 1)}


@dataclass(frozen=True)
class Summary:
    """The contents of summary.json: the paper's numbers over all walks, lengths in m."""

    walks: int
    persons: int
    mean_largest_m: float
    std_largest_m: float
    tube_m: float
    outward_mean_m: float
    error_mean_m: float
    error_max_m: float
    arrived_fraction: float
    arrival_mean_s: float
    as_the_paper: bool
    """Mean below 5 cm for every s, std below 10 cm, everyone in a tube of 60 cm, outward drift in the bend."""


def summarise(result: Result, shared: Common) -> Summary:
    """The numbers of a campaign."""
    columns = result.columns
    arrived = np.isfinite(columns["arrival_s"])
    mean, std = _largest(np.abs(shared.mean_m)), _largest(shared.std_m)
    outward = _mean(columns["outward_m"])
    paper = mean < PAPER_MEAN_M and std < PAPER_STD_M and shared.tube_m < PAPER_TUBE_M and outward > 0.0
    return Summary(
        walks=len(result.errors),
        persons=len(np.unique(columns["person"])),
        mean_largest_m=mean,
        std_largest_m=std,
        tube_m=shared.tube_m,
        outward_mean_m=outward,
        error_mean_m=_mean(columns["error_mean_m"]),
        error_max_m=_largest(columns["error_max_m"]),
        arrived_fraction=float(np.mean(arrived)),
        arrival_mean_s=_mean(columns["arrival_s"]),
        as_the_paper=paper,
    )


def _largest(x: Array) -> float:
    return float(np.max(np.nan_to_num(x), initial=0.0))


def _mean(x: Array) -> float:
    known = np.asarray(x)[np.isfinite(x)]
    return float(np.mean(known)) if len(known) else 0.0


def write(result: Result, title: str, folder: Path) -> Summary:
    """Write everything into `folder`."""
    shared = common(result.errors)
    summary = summarise(result, shared)
    _write_csv(folder / "runs.csv", result.columns)
    outermost = {"low_m": shared.low_m, "high_m": shared.high_m}
    _write_csv(folder / "errors.csv", {"s": STATIONS, "mean_m": shared.mean_m, "std_m": shared.std_m} | outermost)
    _write_traces(folder / "traces.npz", result)
    (folder / "summary.json").write_text(json.dumps(asdict(summary), indent=2) + "\n", encoding="utf-8")
    files = figure.draw_all(result, folder)
    (folder / "index.html").write_text(_page(result, summary, title, files), encoding="utf-8")
    return summary


def _write_csv(file: Path, columns: Columns) -> None:
    with file.open("w", newline="", encoding="utf-8") as out:
        rows = csv.writer(out)
        rows.writerow(columns)
        rows.writerows(
            [f"{x:.9g}" if np.isfinite(x) else "" for x in row] for row in zip(*columns.values(), strict=True)
        )


def _write_traces(file: Path, result: Result) -> None:
    """x and y in m of each walk that was kept, one array a walk, by the number of its row in runs.csv."""
    runs: dict[str, Any] = {f"run_{i:05d}": trace for i, trace in enumerate(result.traces)}
    with file.open("wb") as out:
        np.savez_compressed(out, allow_pickle=False, **runs)


def claims(summary: Summary) -> Iterator[tuple[str, str, str]]:
    """The paper's statistics: name, value, the paper's."""
    yield "mean path error, largest over s", f"{100 * summary.mean_largest_m:.1f} cm", f"{100 * PAPER_MEAN_M:g} cm"
    yield "its standard deviation, largest over s", f"{100 * summary.std_largest_m:.1f} cm", f"{100 * PAPER_STD_M:g} cm"
    yield "tube that holds everyone", f"{100 * summary.tube_m:.1f} cm", f"{100 * PAPER_TUBE_M:g} cm"
    yield "drift to the outside of the bend, mean", f"{100 * summary.outward_mean_m:+.1f} cm", "outward"
    yield "path error of a walk, mean", f"{100 * summary.error_mean_m:.1f} cm", ""
    yield "path error, largest", f"{100 * summary.error_max_m:.1f} cm", ""
    yield "arrived within 10 cm of the end", f"{100 * summary.arrived_fraction:.1f} %", ""
    yield "after, mean", f"{summary.arrival_mean_s:.1f} s", ""


def show(result: Result, summary: Summary, console: Console) -> None:
    """The paper's numbers, and the persons, on a terminal."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    for heading in (f"{summary.walks} walks of {summary.persons} persons", "here", "paper, at most"):
        table.add_column(heading, justify="left" if heading.endswith("persons") else "right")
    for row in claims(summary):
        table.add_row(*row)
    console.print(table)
    headings, rows = persons_table(result)
    each = Table(box=box.SIMPLE_HEAD, padding=0)
    for heading in headings[:TERMINAL_COLUMNS]:
        each.add_column(heading.replace(" (", "\n("), justify="right", no_wrap=True)
    for row in rows[:TERMINAL_PERSONS]:
        each.add_row(*row[:TERMINAL_COLUMNS])
    console.print(each)
    if len(rows) > TERMINAL_PERSONS:
        console.print(f"and {len(rows) - TERMINAL_PERSONS} more: runs.csv", style="dim")


def persons_table(result: Result) -> tuple[list[str], list[list[str]]]:
    """Headings, and one row for each person: means over their walks."""
    rows = persons(result.columns)
    shown = {name: how for name, how in (_BODY | _MEASURED).items() if name in rows}
    headings = ["person", "walks", *(f"{label} ({unit})" for label, _, unit, _ in shown.values())]
    body = [
        [
            f"{rows['person'][i]:.0f}",
            f"{rows['walks'][i]:.0f}",
            *(_cell(rows[name][i] * factor, digits) for name, (_, factor, _, digits) in shown.items()),
        ]
        for i in range(len(rows["person"]))
    ]
    return headings, body


def _cell(x: float, digits: int) -> str:
    return f"{x:.{digits}f}" if np.isfinite(x) else "never"


def _page(result: Result, summary: Summary, title: str, pictures: Sequence[Path]) -> str:
    """One file that needs nothing else."""
    headings, rows = persons_table(result)
    more = (
        f"<p>The first {SHOWN_PERSONS} of {len(rows)} persons; all are in runs.csv.</p>"
        if len(rows) > SHOWN_PERSONS
        else ""
    )
    parts = [
        f"<h1>{html.escape(title)}</h1>",
        _table(("", "here", "the paper, at most"), claims(summary)),
        *(f'<img alt="{file.stem}" src="data:image/png;base64,{_base64(file)}">' for file in pictures),
        "<h2>Person by person</h2>",
        "<p>Means over each person's walks. Path error is taken where the hand crosses the normal to the path; outward is",
        "to the outside of the path's bends.</p>",
        _table(headings, rows[:SHOWN_PERSONS]),
        more,
    ]
    return _HEAD.replace("TITLE", html.escape(title)) + "\n".join(parts) + "\n</main></html>\n"


def _table(headings: Sequence[str], rows: Iterator[tuple[str, str, str]] | Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in headings)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _base64(file: Path) -> str:
    return base64.b64encode(file.read_bytes()).decode()


_HEAD = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>TITLE</title>
<style>
body { font: 15px/1.45 system-ui, sans-serif; color: #222; background: #fff; margin: 0 }
main { max-width: 62rem; margin: 2rem auto; padding: 0 1rem }
h1 { font-size: 1.5rem } h2 { font-size: 1.15rem; margin-top: 2rem }
img { width: 100%; margin: 1rem 0 }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: 1rem 0; display: block; overflow-x: auto }
th, td { padding: .25rem .8rem; text-align: right; border-bottom: 1px solid #ddd; white-space: nowrap }
th { font-weight: 600 } th:first-child, td:first-child { text-align: left }
</style><main>
"""
