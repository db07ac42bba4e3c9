"""A campaign as a plan on disk, done in batches of walks: each finished batch is a file, so an interrupted run goes on.

Everything random comes from the plan's seed: the same plan gives the same walks, in whatever batches and processes.
"""

import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.campaign import population, statistics, vary
from services.campaign.population import UNIFORMS, Columns
from services.campaign.robot import ROBOTS
from services.campaign.statistics import Result
from services.campaign.walk import Controller, Experiment, People, Walks, start, walk
from services.config import Config
from services.physics import Array, norm, vector

BATCH = 1000
TRACES = 1000
"""So many walks keep where they went; the rest only their numbers."""
PLAN = "campaign.json"


@dataclass(frozen=True)
class Plan:
    """All that decides the outcome. `population` is the content of its file, `config` the resolved configuration."""

    people: int
    trials: int
    seed: int
    controller: Controller
    robot: str
    vary: str
    duration_s: float
    batch: int
    population: dict[str, Any]
    config: dict[str, Any]

    @property
    def walks(self) -> int:
        """How many there are."""
        return self.people * self.trials

    @property
    def batches(self) -> int:
        """How many files they are done in."""
        return -(-self.walks // self.batch)

    def slice(self, index: int) -> slice:
        """Which walks are in a batch."""
        return slice(index * self.batch, min((index + 1) * self.batch, self.walks))

    def write(self, folder: Path) -> None:
        """Keep it in the campaign's folder."""
        (folder / "batches").mkdir(parents=True, exist_ok=True)
        (folder / PLAN).write_text(json.dumps(asdict(self), indent=1) + "\n", encoding="utf-8")


def read_plan(folder: Path) -> Plan:
    """The plan of a campaign's folder. Raises ValueError or OSError where there is none."""
    try:
        data = json.loads((folder / PLAN).read_text(encoding="utf-8"))
        return Plan(**data | {"controller": Controller(data["controller"])})
    except (KeyError, TypeError, json.JSONDecodeError):
        raise ValueError(f"{folder / PLAN}: is not the plan of a campaign") from None


@dataclass(frozen=True, eq=False)
class Prepared:
    """A plan worked out: the columns of all walks, and what they are walked with."""

    plan: Plan
    config: Config
    columns: Columns
    base: Experiment
    left_W: Array

    def people(self, which: slice | int) -> People:
        """The people of some walks."""
        return population.people(self.columns, which, self.left_W)

    def experiment(self, which: slice | int) -> Experiment:
        """What they walk with."""
        return vary.experiment(self.base, self.columns, which)

    def walk(self, which: slice | int, progress: Callable[[float], None] = lambda _: None) -> Walks:
        """Simulate some of the walks together, or one alone."""
        who, x = self.people(which), self.experiment(which)
        ceiling = who.human.hand_height_m + x.ceiling_above_hand_m
        moved_by = ROBOTS[self.plan.robot](start(who, x)[1], ceiling, x.filter, self.config)
        return walk(who, x, moved_by, self.plan.duration_s, progress)


def prepare(plan: Plan) -> Prepared:
    """Draw everybody. Raises ValueError where somebody cannot be."""
    config = Config.model_validate(plan.config)
    spreads = vary.parse(plan.vary)
    streams = np.random.default_rng(plan.seed).spawn(3)
    columns = population.draw(
        population.build(plan.population),
        streams[0].random((plan.people, UNIFORMS)),
        streams[1].random((plan.people, plan.trials, UNIFORMS)),
    )
    columns |= vary.draw(spreads, streams[2].random((plan.people, 2 * len(spreads))), plan.trials)
    population.check(columns, columns.get("f_z_N", np.array(config.guiding_controller.f_z_N)))
    path = config.guided_path
    along = path.p(1.0) - path.p(0.0)
    return Prepared(
        plan, config, columns, experiment(config, plan.controller), vector(-along[1], along[0], 0.0) / norm(along)
    )


def experiment(config: Config, controller: Controller) -> Experiment:
    """The profile's experiment, without a delay."""
    return Experiment(
        path=config.guided_path,
        cable=config.cable,
        guiding=config.guiding_controller,
        filter=config.px4_bridge.admittance,
        ceiling_above_hand_m=config.px4_bridge.flight.ceiling_m - config.world.hand_height_m,
        slack_margin_m=config.force_estimator.bias.slack_margin_m,
        controller=controller,
        delay_ticks=0,
    )


def file_of(folder: Path, index: int) -> Path:
    """Where a batch is kept."""
    return folder / "batches" / f"{index:05d}.npz"


def missing(folder: Path, plan: Plan) -> list[int]:
    """The batches that are still to be done."""
    return [index for index in range(plan.batches) if not file_of(folder, index).exists()]


@lru_cache(maxsize=1)
def prepared(folder: Path) -> Prepared:
    """The plan in a folder, worked out once in a process."""
    return prepare(read_plan(folder))


def run(folder: Path, index: int, progress: Callable[[float], None] = lambda _: None) -> None:
    """Do one batch; its file appears when it is whole. `progress` is told of each second of a walk."""
    ready = prepared(folder)
    which = ready.plan.slice(index)
    size = which.stop - which.start
    walks = ready.walk(which, lambda seconds: progress(size * seconds))
    x = ready.experiment(which)
    columns, errors = statistics.of_walks(walks.t_s, walks.p_H, walks.p_R, x.path, x.cable.rest_length_m)
    columns |= {"force_max_N": walks.force_max_N, "head_min_m": walks.head_min_m}
    traces = walks.p_H[: max(TRACES - which.start, 0), ::2, :2]
    file = file_of(folder, index)
    unfinished = file.with_suffix(f".{os.getpid()}.part")
    with unfinished.open("wb") as out:
        np.savez(out, errors=errors.astype(np.float32), traces=traces.astype(np.float32), allow_pickle=False, **columns)
    unfinished.replace(file)


def collect(folder: Path) -> Result:
    """All batches of a finished campaign together."""
    ready = prepared(folder)
    parts: list[dict[str, NDArray[Any]]] = []
    for index in range(ready.plan.batches):
        with np.load(file_of(folder, index)) as file:
            parts.append({name: file[name] for name in file.files})
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0].keys() - {"errors", "traces"}}
    errors = np.concatenate([part["errors"] for part in parts])
    traces = [trace for part in parts for trace in part["traces"]]
    measured = dict(sorted(columns.items()))
    varied = [vary.VARIABLES[name].column for name in vary.parse(ready.plan.vary)]
    return Result(ready.base.path, ready.columns | measured, errors, traces, varied)
