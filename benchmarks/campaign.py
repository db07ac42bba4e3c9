"""The campaign's speed: a crowd beside the same laws one person at a time, memory, processes, and cost against the number.

`python -m benchmarks.campaign [--out DIR]` prints the tables and writes campaign_cost.png.
"""

import argparse
import json
import multiprocessing
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from services.campaign import batch
from services.campaign.batch import BATCH, Plan, Prepared
from services.campaign.walk import Controller
from services.config import load
from services.profile_file import deploy_folder, read

SIZES = (1, 3, 10, 30, 100, 300, 1000, 3000, 10_000, 30_000, 100_000)
COUNT = 20_000_000
WALKED_S = 12_000.0
"""So many seconds of walks in all are timed at each size, at least 1 s and at most 20 s each."""


def plan(people: int, seconds: float, size: int = BATCH) -> Plan:
    """A campaign with the general population."""
    population = read(deploy_folder() / "populations" / "general.toml")
    config = load("demo").model_dump(mode="json")
    return Plan(people, 1, 1, Controller.REFERENCE, "ideal", "", seconds, min(size, people), population, config)


def seconds_of(ready: Prepared, which: slice | int) -> float:
    """Processor time of some walks."""
    began = time.process_time()
    ready.walk(which)
    return time.process_time() - began


def one_by_one(people: int = 3, seconds: float = 10.0) -> float:
    """Times real time of the scalar loop, on plain floats."""
    ready = batch.prepare(plan(people, seconds))
    return people * seconds / sum(seconds_of(ready, i) for i in range(people))


def costs() -> list[tuple[int, float]]:
    """For each number of people, microseconds of processor for each person's second, in batches as the command does them."""
    measured: list[tuple[int, float]] = []
    for people in SIZES:
        seconds = round(min(max(WALKED_S / people, 1.0), 20.0))
        ready = batch.prepare(plan(people, seconds))
        total = sum(seconds_of(ready, ready.plan.slice(i)) for i in range(ready.plan.batches))
        measured.append((people, 1e6 * total / (people * seconds)))
    return measured


def whole() -> dict[str, float]:
    """1,000 people x 60 s in a process of its own: the simulation alone, statistics and file with it, peak memory."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        plan(1000, 60.0).write(folder)
        ready = batch.prepared(folder)
        walking = seconds_of(ready, slice(0, 1000))
        began = time.process_time()
        batch.run(folder, 0)
        everything = time.process_time() - began
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"walking": 60_000 / walking, "everything": 60_000 / everything, "peak_MiB": peak}


def processes(jobs: int, people: int = 8000, seconds: float = 60.0) -> float:
    """Wall-clock time of the command's loop over 8 batches, the start of the processes included."""
    from rich.console import Console

    from services.campaign import command

    with tempfile.TemporaryDirectory() as name:
        wanted = plan(people, seconds)
        wanted.write(Path(name))
        began = time.perf_counter()
        command.run_batches(Path(name), wanted, jobs, Console(quiet=True))
        return time.perf_counter() - began


def counting() -> float:
    """How much faster two processes count than one: the most that two can gain, others on the machine included."""
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        pool.map(_count, (1, 1), 1)
        began = time.perf_counter()
        pool.map(_count, (COUNT, COUNT), 1)
        middle = time.perf_counter()
        pool.map(_count, (COUNT,), 1)
        return 2.0 * (time.perf_counter() - middle) / (middle - began)


def _count(until: int) -> int:
    return sum(1 for _ in range(until))


def px4(people: int = 1000, seconds: float = 3.0) -> float:
    """Times real time of the crowd behind PX4-like vehicles."""
    ready = batch.prepare(replace(plan(people, seconds), robot="px4"))
    return people * seconds / seconds_of(ready, slice(0, people))


def draw(measured: list[tuple[int, float]], alone: float, path: Path) -> None:
    """Cost against the number of people, double logarithmic."""
    figure: Any = Figure(figsize=(6.0, 3.4), layout="constrained")
    axes = figure.add_subplot(xlabel="people", ylabel="processor time per person's second (µs)")
    axes.loglog(*zip(*measured, strict=True), "o-", color="#0072B2", label="crowd")
    axes.axhline(1e6 / alone, color="#D55E00", linestyle="--", label="one by one")
    axes.axhline(100.0, color="#8c8c8c", linestyle=":", label="10,000 times real time")
    axes.grid(which="major", color="#dddddd", linewidth=0.5)
    axes.legend(frameon=False)
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description="The campaign's speed.")
    parser.add_argument("--out", type=Path, help="directory of campaign_cost.png")
    parser.add_argument("--whole", action="store_true", help="only the measurement that needs a process of its own")
    arguments = parser.parse_args()
    if arguments.whole:
        print(json.dumps(whole()))
        return
    alone = one_by_one()
    command = [sys.executable, "-m", "benchmarks.campaign", "--whole"]
    crowd = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    print(f"one person at a time           {alone:8.0f} x real time")
    print(
        f"1,000 people x 60 s            {crowd['walking']:8.0f} x real time, {crowd['walking'] / alone:.0f} times that"
    )
    print(
        f"  with statistics and file     {crowd['everything']:8.0f} x real time, peak memory {crowd['peak_MiB']:.0f} MiB"
    )
    one, two = processes(1), processes(2)
    print(f"8 batches, 1 and 2 processes   {one:.1f} s and {two:.1f} s: {one / two:.2f} times as fast")
    print(f"  bare counting, the same way  {counting():.2f} times as fast: what two processes gain on this machine now")
    print(f"1,000 people, px4 robot        {px4():8.0f} x real time")
    measured = costs()
    print("people  µs per person's second  x real time")
    for people, cost in measured:
        print(f"{people:6d}  {cost:22.1f}  {1e6 / cost:11.0f}")
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        draw(measured, alone, arguments.out / "campaign_cost.png")


if __name__ == "__main__":
    main()
