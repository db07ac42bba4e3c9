"""`clew campaign`: many people walk, in some processes, and what comes out is written, shown and kept."""

import sys
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from services.campaign import batch, population, processes, recorded, report
from services.campaign.batch import BATCH, Plan
from services.campaign.robot import ROBOTS
from services.campaign.statistics import Result
from services.campaign.walk import Controller
from services.config import ConfigError, load
from services.profile_file import find, read

DURATION_MAX_S = 3600.0


@dataclass(frozen=True, kw_only=True)
class Options:
    """What was asked for on the command line."""

    profile: str = "demo"
    path: str = ""
    population: str = "paper"
    people: int = 4
    trials: int = 2
    seed: int = 1
    controller: str = Controller.REFERENCE.value
    robot: str = "ideal"
    vary: str = ""
    seconds: float = 60.0
    jobs: int = 1
    out: Path | None = None
    resume: bool = False
    sessions: list[Path] = field(default_factory=list[Path])


class Interrupted(Exception):
    """The campaign was stopped; what was finished is kept."""


def campaign(options: Options) -> int:
    """Run, or go on with, a campaign, or look at recorded sessions. Returns the exit code: 0, or 2 with one line why."""
    console = Console()
    try:
        folder = _folder(options)
        if options.sessions:
            return _tell(recorded.read(options.sessions), f"{len(options.sessions)} recorded walks", folder, console)
        plan = _plan(options, folder)
        run_batches(folder, plan, options.jobs, console)
        return _tell(batch.collect(folder), _title(plan), folder, console)
    except Interrupted as stopped:
        print(f"stopped: {stopped}", file=sys.stderr)  # noqa: T201
    except (ConfigError, ValueError, OSError) as error:
        print(error, file=sys.stderr)  # noqa: T201
    return 2


def _folder(options: Options) -> Path:
    """Where the campaign is kept; made, and known to be writable, before anybody walks."""
    if options.resume and options.out is None:
        raise ValueError("--resume: --out must say which campaign")
    folder = options.out or Path("campaigns") / datetime.now().astimezone().strftime("%Y-%m-%dT%H-%M-%S")
    if (folder / batch.PLAN).exists() and not options.resume:
        raise ValueError(f"--out = {folder}: holds a campaign already; --resume goes on with it")
    if options.resume:
        return folder
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise ValueError(f"--out = {folder}: cannot be written: {error.strerror}") from None
    return folder


def _plan(options: Options, folder: Path) -> Plan:
    """The plan on disk, or a new one, which everybody in it can walk by."""
    _require(options.jobs >= 1, "--jobs", options.jobs, "at least 1")
    if options.resume:
        return batch.read_plan(folder)
    _require(options.people >= 1, "--people", options.people, "at least 1")
    _require(options.trials >= 1, "--trials", options.trials, "at least 1")
    _require(options.seed >= 0, "--seed", options.seed, "at least 0")
    _require(1.0 <= options.seconds <= DURATION_MAX_S, "--seconds", options.seconds, f"1 to {DURATION_MAX_S:g}")
    _require(
        options.controller in list(Controller), "--controller", options.controller, f"one of {', '.join(Controller)}"
    )
    _require(options.robot in ROBOTS, "--robot", options.robot, f"one of {', '.join(ROBOTS)}")
    file = find("populations", options.population, "--population = ")
    population.read(file)
    share = -(-options.people * options.trials // options.jobs)
    plan = Plan(
        people=options.people,
        trials=options.trials,
        seed=options.seed,
        controller=Controller(options.controller),
        robot=options.robot,
        vary=options.vary,
        duration_s=options.seconds,
        batch=min(BATCH, share),
        population=read(file),
        config=load(options.profile, path=options.path).model_dump(mode="json"),
    )
    batch.prepare(plan)
    plan.write(folder)
    return plan


def _require(holds: bool, key: str, value: object, limit: str) -> None:
    if not holds:
        raise ValueError(f"{key} = {value}: must be {limit}")


def _title(plan: Plan) -> str:
    name = plan.population.get("name", "")
    varied = f", {plan.vary}" if plan.vary else ""
    return (
        f"{plan.people} people x {plan.trials} walks of {plan.duration_s:g} s: population {name}, {plan.robot} robot, "
        f"{plan.controller} controller, seed {plan.seed}{varied}"
    )


def run_batches(folder: Path, plan: Plan, jobs: int, console: Console) -> None:
    """Do what is missing, under a bar with the time left. Raises Interrupted on Ctrl-C."""
    todo = batch.missing(folder, plan)
    sizes = {index: (which := plan.slice(index)).stop - which.start for index in range(plan.batches)}
    total = plan.walks * plan.duration_s
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    console.print(_title(plan), highlight=False, soft_wrap=True)
    with Progress(*columns, console=console, transient=True) as bar:
        done = total - plan.duration_s * sum(sizes[index] for index in todo)
        task = bar.add_task(f"{plan.walks} walks", total=total)
        bar.update(task, completed=done)
        try:
            if jobs == 1 or len(todo) == 1:
                for index in todo:
                    batch.run(folder, index, lambda seconds: bar.advance(task, seconds))
            else:
                processes.run(folder, todo, jobs, lambda seconds: bar.update(task, completed=done + seconds))
        except KeyboardInterrupt:
            kept = plan.batches - len(batch.missing(folder, plan))
            again = f"clew campaign --resume --out {folder}"
            raise Interrupted(f"{kept} of {plan.batches} batches are kept; go on with: {again}") from None


def _tell(result: Result, title: str, folder: Path, console: Console) -> int:
    summary = report.write(result, title, folder)
    report.show(result, summary, console)
    console.print(f"figures, page and tables: {folder}", soft_wrap=True, highlight=False, markup=False)
    return 0
