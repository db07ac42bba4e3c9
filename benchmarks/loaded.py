"""The guided walk in real time on a host that has ten times too much to do, and whose loops go before nobody.

`python -m benchmarks.loaded` flies it and prints what the supervisor said, how old the force was that was flown, and what
the hand felt, before and under the load. `--loops 20` busy loops, `--seconds 20`.
"""

import argparse
import asyncio
import os
import shutil
import sys
import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from schemas.safety import Level, Phase
from schemas.topics import SAFETY_STATE, SETPOINT
from schemas.vehicle import SetpointKind
from tests.processes import host
from tests.processes.system import System, fly
from tests.processes.window import NEVER, Window

BEFORE_S, SETTLED_S = 3.0, 0.5
LOOP = ("chrt", "-o", "0", sys.executable, "-c", "while True: pass")


def main() -> int:
    """As the module says."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--loops", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=20.0)
    wanted = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="clew-loaded-"))
    try:
        show(*fly(folder, lambda system: loaded(system, wanted.loops, wanted.seconds)), wanted.loops)
    finally:
        shutil.rmtree(folder)
    return 0


async def loaded(system: System, count: int, seconds: float) -> tuple[Window, Window, float]:
    """The walk before and under the load, and the load average at its end."""
    await system.guided()
    for name in system.config.system.services:
        host.go_with_the_others(system.pid(name))
    with system.window() as before:
        await asyncio.sleep(BEFORE_S)
    loops = [await asyncio.create_subprocess_exec(*LOOP) for _ in range(count)]
    with system.window() as under:
        await asyncio.sleep(seconds)
    load = os.getloadavg()[0]
    for loop in loops:
        loop.kill()
        await loop.wait()
    return before, under, load


def show(before: Window, under: Window, load: float, count: int) -> None:
    """One table."""
    title = f"the guided walk with {count} busy loops on {os.cpu_count()} cores, all at one priority; load average {load:.0f}"
    table = Table("", "before", "under the load", title=title)
    for what, values in {
        "age of the force in a set-point, mean ms": [f"{1e3 * np.mean(ages(w)):.0f}" for w in (before, under)],
        "largest ms": [f"{1e3 * max(ages(w)):.0f}" for w in (before, under)],
        "pull on the hand, largest N": [f"{w.pull_N(0.0):.2f}" for w in (before, under)],
        "commanded, largest N": [f"{w.commanded_N():.2f}" for w in (before, under)],
        "longest without a set-point ms": [f"{1e3 * gap_s(w):.0f}" for w in (before, under)],
        "eased after s": ["-", f"{under.backs_off_s():.2f}"],
        f"pull later than {SETTLED_S:g} s after that, largest N": ["-", f"{eased_N(under):.2f}"],
        "of the time eased or held %": [f"{slack_percent(w):.0f}" for w in (before, under)],
        "gravest level": [max(w.levels(), default=Level.OK).name.lower() for w in (before, under)],
        "phases": [", ".join(w.phases()) for w in (before, under)],
        "comes down": [str(bool({Phase.CLEARING, Phase.LANDING} & set(w.phases()))) for w in (before, under)],
    }.items():
        table.add_row(what, *values)
    Console(width=140).print(table)
    for t, told in first_told(under):
        print(f"{t:6.2f} s  {told}")


def ages(w: Window) -> list[float]:
    """Of the force in each set-point, s."""
    return [m.age_s for _, m in w.all(SETPOINT)] or [0.0]


def gap_s(w: Window) -> float:
    """The longest between two set-points."""
    return float(max(np.diff([t for t, _ in w.all(SETPOINT)]), default=NEVER))


def eased_N(w: Window) -> float:
    """The strongest pull at any time that had been without one for a while."""
    slack_since, most = NEVER, 0.0
    kinds = w.all(SETPOINT)
    for (t, m), (after_s, _) in pairwise(kinds):
        slack_since = min(slack_since, t) if m.kind in (SetpointKind.EASE, SetpointKind.HOLD) else NEVER
        if t > slack_since + SETTLED_S:
            most = max(most, w.pull_N(t, after_s))
    return most


def slack_percent(w: Window) -> float:
    """Of the set-points, those without a pull."""
    return 100.0 * float(np.mean([m.kind is not SetpointKind.ADMITTANCE for _, m in w.all(SETPOINT)] or [0.0]))


def first_told(w: Window) -> list[tuple[float, str]]:
    """What the operator was told first, when it was first told."""
    told: dict[str, float] = {}
    for t, m in w.all(SAFETY_STATE):
        if m.reasons:
            told.setdefault(f"{m.level.name.lower()}: {m.reasons[0]}", t)
    return [(t, text) for text, t in told.items()]


if __name__ == "__main__":
    sys.exit(main())
