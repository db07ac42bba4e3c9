"""The demo, flown in real time as its own processes: the numbers it must reach, and what each service costs.

`python -m benchmarks.flight_demo --flights 3`
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.table import show
from schemas.topics import HEALTH
from services.recorder.reading import read

COLUMNS = (
    "flight",
    "ok",
    "mean cm",
    "max cm",
    "end cm",
    "slack %",
    "hand N",
    "force rms N",
    "track rms cm",
    "lost",
    "stalls",
    "phase 2 s",
)
CPU_COLUMNS = ("service", "cpu % of a core (median)", "loop Hz", "late p99 ms (worst)", "missed", "longest stall ms")
LATENCY_COLUMNS = ("handle sample -> set-point that contains it", "p50 ms", "p99 ms")


def fly(out: Path, seed: int, profile: str = "demo") -> dict[str, Any]:
    """One demo; its summary, with the session's folder under `folder`."""
    command = [sys.executable, "-P", "-m", "services.console.cli", "demo", "--profile", profile, "--no-live"]
    command += ["--seed", str(seed), "--out", str(out)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    file = out / "latest" / "summary.json"
    if not file.exists():
        raise RuntimeError(f"the demo ended with {ended.returncode}:\n{ended.stderr[-2000:]}")
    return json.loads(file.read_text()) | {"folder": (out / "latest").resolve()}


def row(n: int, s: dict[str, Any]) -> tuple[str, ...]:
    """One flight under COLUMNS."""

    def number(value: float | None, factor: float = 1.0, form: str = ".2f") -> str:
        return "-" if value is None else f"{value * factor:{form}}"

    return (
        str(n),
        "yes" if s["ok"] else "NO",
        number(s["path_error"]["mean_m"], 100),
        number(s["path_error"]["max_m"], 100),
        number(s["end_error_m"], 100),
        number(s["slack_fraction"], 100),
        number(s["hand_force"]["max_n"]),
        number(s["force_error"]["rms_n"], 1, ".3f"),
        number(s["tracking_error"]["rms_m"], 100),
        str(s["messages_lost"]),
        str(s["host_stalls"]),
        number(s["durations_s"].get("guiding"), 1, ".1f"),
    )


def cpu_rows(folder: Path) -> list[tuple[str, ...]]:
    """What each service of a session cost, from its own heartbeats."""
    session, total = read(folder / "session.mcap"), 0.0
    rows: list[tuple[str, ...]] = []
    for name, topic in HEALTH.items():
        beats = session.table(topic)
        if not len(beats["t_s"]):  # a gateway, on one host
            continue
        cpu = float(np.median(beats["cpu_fraction"]))
        total += cpu
        rows.append(
            (
                name,
                f"{100 * cpu:.0f}",
                f"{np.median(beats['loop_rate_Hz']):.0f}",
                f"{np.max(beats['loop_lateness_p99_ms']):.1f}",
                str(int(beats["missed_periods"][-1])),
                f"{np.max(beats['longest_stall_ms']):.0f}",
            )
        )
    return [*rows, ("all", f"{100 * total:.0f}", "", "", "", "")]


def latency_rows(summary: dict[str, Any]) -> list[tuple[str, ...]]:
    """Read off the recording by provenance."""
    return [(stage, f"{s['p50_ms']:.1f}", f"{s['p99_ms']:.1f}") for stage, s in summary["latency"].items()]


def run(flights: int, profile: str = "demo") -> None:
    """Fly and print the three tables."""
    with tempfile.TemporaryDirectory() as folder:
        summaries = [fly(Path(folder), seed + 1, profile) for seed in range(flights)]
        show([row(n + 1, s) for n, s in enumerate(summaries)], COLUMNS)
        show(cpu_rows(summaries[-1]["folder"]), CPU_COLUMNS)
        show(latency_rows(summaries[-1]), LATENCY_COLUMNS)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=1)
    parser.add_argument("--profile", default="demo")
    told = parser.parse_args()
    run(told.flights, told.profile)
