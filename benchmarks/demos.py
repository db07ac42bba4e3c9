"""Many real-time demos, one after the other, each with another seed: whether any of them raised an alarm for nothing.

`python -m benchmarks.demos --flights 10`
"""

import argparse
import os
import sys
import tempfile
from pathlib import Path

from benchmarks.flight_demo import fly
from benchmarks.table import show
from schemas.safety import Level, Phase
from schemas.topics import SAFETY_STATE
from services.recorder.alarms import alarms
from services.recorder.reading import read
from services.simulator.autopilot import STEP_S

COLUMNS = (
    "seed",
    "ok",
    "mean cm",
    "max cm",
    "highest level",
    "host stalls",
    "missed %",
    "load",
    "what was said above warn",
)
GROUND = (Phase.IDLE, Phase.LANDED)


def flown(out: Path, seed: int, profile: str) -> tuple[Level, tuple[str, ...]]:
    """One flight under COLUMNS, and the highest level that was said in the air."""
    summary = fly(out, seed, profile)
    session = read(summary["folder"] / "session.mcap")
    told = [alarm for alarm in alarms(session.table(SAFETY_STATE)) if alarm.phase not in GROUND]
    highest = max((alarm.level for alarm in told), default=Level.OK)
    missed = summary["services"]["simulator"]["missed_periods"] * STEP_S / session.duration_s
    error = summary["path_error"]
    return highest, (
        str(seed),
        "yes" if summary["ok"] else "NO",
        *("-" if m is None else f"{100 * m:.2f}" for m in (error["mean_m"], error["max_m"])),
        highest.name.lower(),
        str(summary["host_stalls"]),
        f"{100 * missed:.2f}",
        f"{os.getloadavg()[0]:.1f}",
        "; ".join(dict.fromkeys(alarm.text for alarm in told if alarm.level > Level.WARN)),
    )


def main() -> int:
    """Fly and tell; 0 when no flight raised anything above a warning."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--profile", default="demo")
    told = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        seeds = range(told.first_seed, told.first_seed + told.flights)
        flights = [flown(Path(folder), seed, told.profile) for seed in seeds]
    show([row for _, row in flights], COLUMNS)
    loud = sum(level > Level.WARN for level, _ in flights)
    print(f"{len(flights) - loud} of {len(flights)} flights raised nothing above warn")
    return 1 if loud else 0


if __name__ == "__main__":
    sys.exit(main())
