"""What the radio's delay does to the walk, on virtual time: `make figures` draws it, `python -m benchmarks.delay` prints it.

The experiment of the two-host profile, once for each one-way delay (2 ms of jitter). Its limits on the age of what
crossed the radio are widened, so that it can be seen what they spare the person; where the profile itself would not
start, the table says so.
"""

import argparse
import asyncio
import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from schemas.safety import Action, Phase
from services.config import Config, load
from services.recorder.reading import Session
from services.recorder.summary import summarise
from services.rehearsal.chain import Stage
from tests.services.two_hosts import Radio, fly_as

DELAYS_ms = (0.0, 50.0, 100.0, 150.0, 200.0, 250.0, 300.0, 350.0, 400.0, 450.0, 500.0)
JITTER_ms = 1.0


class Walk(NamedTuple):
    """One flight; lengths in m, force in N. None where there was none."""

    delay_ms: float
    mean_m: float | None
    max_m: float | None
    force_max_N: float | None
    slack_fraction: float | None
    guiding_s: float


def widened(config: Config) -> Config:
    """What crossed the radio may be a second old, and the clocks as uncertain as that."""
    assert config.radio
    supervisor, autopilot = config.safety_supervisor, config.simulator.autopilot
    limits = replace(supervisor.limits, age_ease_s=1.0, age_hold_s=2.0, clock_uncertainty_max_s=1.0)
    estimator = replace(autopilot.estimator, delay_max_s=1.0)
    return config.model_copy(
        update={
            "radio": replace(config.radio, delay_allowed_s=0.8),
            "safety_supervisor": replace(supervisor, limits=limits),
            "simulator": replace(config.simulator, autopilot=replace(autopilot, estimator=estimator)),
        }
    )


def patient(config: Config) -> Config:
    """The profile as it is, but for the clocks: half of a round trip is what they are known to."""
    supervisor = config.safety_supervisor
    limits = replace(supervisor.limits, clock_uncertainty_max_s=1.0)
    return config.model_copy(update={"safety_supervisor": replace(supervisor, limits=limits)})


async def experiment(stage: Stage, _radio: Radio) -> None:
    """From start to landing, or until it is clear that there will be none."""
    await asyncio.sleep(2.5)
    stage.ask(Action.START)
    try:
        await stage.until(lambda state: state.phase is Phase.LANDED, 90.0)
    except TimeoutError:
        return


def walk(delay_ms: float, *, wide: bool = True) -> Walk:
    """One flight over a radio with that delay each way."""
    config = load("ground-sim")
    one_way_s = (max(delay_ms - JITTER_ms, 0.0) * 1e-3, (delay_ms + JITTER_ms) * 1e-3)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "session.mcap")
        fly_as((widened if wide else patient)(config), experiment, {"ground": file}, one_way_s)
        told = summarise(Session(file))
    return Walk(
        delay_ms,
        told.path_error.mean_m,
        told.path_error.max_m,
        told.hand_force.max_n,
        told.slack_fraction,
        told.durations_s.get("guiding", 0.0),
    )


def own(delay_ms: float) -> bool:
    """Whether the profile's own limits let it walk."""
    return walk(delay_ms, wide=False).guiding_s > 0.0


def draw(walks: list[Walk], refused_ms: float | None, file: Path) -> None:
    """Error and force over delay, and where the profile refuses."""
    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    x = [each.delay_ms for each in walks]
    above.plot(x, [100 * (each.max_m or 0.0) for each in walks], "o-", label="largest")
    above.plot(x, [100 * (each.mean_m or 0.0) for each in walks], "o-", label="mean")
    above.set_ylabel("path error / cm")
    above.set_ylim(bottom=0.0)
    below.plot(x, [each.force_max_N or 0.0 for each in walks], "o-", label="largest force on the hand / N")
    below.plot(x, [10 * (each.slack_fraction or 0.0) for each in walks], "o-", label="cable slack / 10 %")
    below.set_xlabel("one-way delay / ms")
    below.set_ylim(bottom=0.0)
    for axes, free in ((above, "lower left"), (below, "center left")):
        if refused_ms is not None:
            axes.axvspan(refused_ms, x[-1], alpha=0.12, color="0.3", label="refused by the profile")
        axes.grid(alpha=0.3)
        axes.legend(loc=free, fontsize=8)
    figure.savefig(file, dpi=110)  # pyright: ignore[reportUnknownMemberType]


def show(walks: list[Walk], starts: dict[float, bool]) -> None:
    """The numbers."""
    columns = ("one-way ms", "mean error cm", "max cm", "force max N", "slack %", "guiding s", "profile's own limits")
    table = Table(*columns, title="the experiment over a radio that delays, on virtual time")
    for each in walks:
        values = (each.mean_m, each.max_m)
        table.add_row(
            f"{each.delay_ms:g}",
            *("-" if value is None else f"{100 * value:.2f}" for value in values),
            "-" if each.force_max_N is None else f"{each.force_max_N:.2f}",
            "-" if each.slack_fraction is None else f"{100 * each.slack_fraction:.1f}",
            f"{each.guiding_s:.1f}",
            "walks" if starts[each.delay_ms] else "refuses",
        )
    Console(width=120).print(table)


def main() -> None:
    """As the module says."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", type=Path, default=None, help="folder for delay.png")
    wanted = parser.parse_args()
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        walks, starts = list(pool.map(walk, DELAYS_ms)), dict(zip(DELAYS_ms, pool.map(own, DELAYS_ms), strict=True))
    show(walks, starts)
    if wanted.out:
        draw(walks, next((d for d, walks_so in starts.items() if not walks_so), None), wanted.out / "delay.png")


if __name__ == "__main__":
    main()
