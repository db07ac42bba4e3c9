"""`clew map`: fly the map of G5, print it, draw it, and say of each cell whether a person could be tied to it."""

import dataclasses
import sys
from collections.abc import Iterable
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from services import config
from services.campaign import stability, stability_figure
from services.campaign.stability import Flown, Grid, Setup
from services.campaign.values import Limits, values
from services.config import ConfigError
from services.console import terminal
from services.px4_bridge.admittance import RATIO_MAX, RATIO_MIN

FREQUENCY_HZ = np.geomspace(0.5, 8.0, 17)
CALM_N = 0.3
"""Tension std that a cell may have: beyond it the held-handle rule can no longer tell a hand from a swing."""
NOT_PASSIVE_MPS_PER_N = -1e-4  # of Re Y; nearer to zero is the noise of the fit
CELLS_MAX, PANELS_MAX = 5000, 24
LIMITS = {
    "ratio": Limits(0.1, 10.0),
    "k-c": Limits(1.0, 5000.0),
    "observer-hz": Limits(0.5, 60.0),
    "delay-ms": Limits(0.0, 100.0),
    "d-c": Limits(0.0, 100.0),
    "lead-s": Limits(0.0, 1.0),
    "seconds": Limits(4.0, 120.0),
}
ASSUMED = (
    "Assumed: the hand is fixed, 1.5 N along and 1 N up on a taut cable that is fixed to the centre of mass; attitude and",
    "thrust are known; no wind, no vibration beyond the accelerometer's noise; an autopilot like PX4 with MPC_ACC_DECOUPLE = 0",
    "and the gains of the vehicle's file, fitted to flights on real PX4. Nothing here has flown on hardware.",
    "In brackets: real PX4 in simulation, where that cell was flown; it was flown with --lead-s 0.",
)


class Asked(NamedTuple):
    """The command's options as they were typed."""

    vehicle: str = "medium,light"
    ratio: str = "0.53,0.67,0.8,0.9,1,1.33,2"
    k_c: str = "50,100,200,400"
    observer_hz: str = "8"
    delay_ms: str = "8"
    d_c: float = 1.0
    lead_s: float | None = None
    seconds: float = 20.0
    profile: str = "demo"


def run(asked: Asked, out: Path) -> int:
    """Fly, print, write `stability_map.png` and `stability_map.csv` into `out`; 2 for bad input, told in one line."""
    try:
        grid, setups = _grid(asked), _setups(asked)
        _writable(out)
    except (ConfigError, ValueError) as error:
        print(f"clew map: {error}", file=sys.stderr)  # noqa: T201
        return 2
    console = terminal.console()
    maps = [_fly(name, grid, setup, asked.seconds, console) for name, setup in setups.items()]
    for flown in maps:
        for observer, delay in product(range(len(grid.observer_Hz)), range(len(grid.delay_ms))):
            console.print(_table(flown, observer, delay))
    console.print(f"Damping of the cable: {asked.d_c:g} N s/m.", *ASSUMED, sep="\n", soft_wrap=True, highlight=False)
    stability_figure.draw(maps, out / "stability_map.png")
    (out / "stability_map.csv").write_text(_csv(maps))
    console.print(f"figure and cells: {out}", soft_wrap=True, highlight=False, markup=False)
    return 0


def verdict(std_N: float, min_N: float) -> str:
    """`slack` where the cable went slack, `sways` where the tension varies too much, else `calm`."""
    return "slack" if min_N <= 0.0 else "sways" if not std_N <= CALM_N else "calm"


def _grid(asked: Asked) -> Grid:
    given = {
        "ratio": asked.ratio,
        "k-c": asked.k_c,
        "observer-hz": asked.observer_hz,
        "delay-ms": asked.delay_ms,
    }
    grid = Grid(*(values(f"--{key}", text, LIMITS[key]) for key, text in given.items()))
    grid = grid._replace(delay_ms=stability.whole_ticks(grid.delay_ms))
    cells, panels = int(np.prod([len(axis) for axis in grid])), len(grid.observer_Hz) * len(grid.delay_ms)
    if cells > CELLS_MAX:
        raise ValueError(f"{cells} cells: at most {CELLS_MAX} (ratio x k-c x observer-hz x delay-ms)")
    if panels > PANELS_MAX:
        raise ValueError(
            f"{panels} pairs of observer-hz and delay-ms: at most {PANELS_MAX}, each is a row of the figure"
        )
    _within("seconds", asked.seconds)
    return grid


def _setups(asked: Asked) -> dict[str, Setup]:
    """By vehicle; filter and cable are the profile's."""
    _within("d-c", asked.d_c)
    base = config.load(asked.profile)
    lead_s = base.px4_bridge.flight.lead_s if asked.lead_s is None else asked.lead_s
    _within("lead-s", lead_s)
    line = dataclasses.replace(base.cable, d_c_Ns_per_m=asked.d_c)
    names = [name.strip() for name in asked.vehicle.split(",")]
    return {
        Path(name).stem: Setup(config.load_vehicle(name), base.px4_bridge.admittance, line, lead_s) for name in names
    }


def _within(key: str, value: float) -> None:
    limits = LIMITS[key]
    if not limits.low <= value <= limits.high:
        raise ValueError(f"--{key} = {value:g}: must be between {limits.low:g} and {limits.high:g}")


def _writable(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / "stability_map.csv").touch()
    except OSError as error:
        raise ValueError(f"--out = {out}: {error.strerror}, must be a folder that can be written") from None


def _fly(name: str, grid: Grid, setup: Setup, seconds: float, console: Console) -> Flown:
    def watch(what: str, ticks: range) -> Iterable[int]:
        return track(ticks, f"{name}: {what}", console=console, transient=True, disable=not console.is_terminal)

    tension = stability.fly(grid, setup, seconds, watch=lambda ticks: watch("the cells", ticks))
    port = stability.port(grid, setup, FREQUENCY_HZ, watch=lambda ticks: watch("the cable port", ticks))
    return Flown(name, setup.vehicle.quadrotor.mass_kg, setup.lead_s, grid, tension, port)


def _table(m: Flown, observer: int, delay: int) -> Table:
    grid = m.grid
    table = Table(
        title=f"{m.name}, {m.mass_kg:g} kg, observer {grid.observer_Hz[observer]:g} Hz, {grid.delay_ms[delay]:g} ms each way, "
        f"lead {m.lead_s:g} s: tension std in N (real PX4)",
        title_justify="left",
    )
    for head in (
        "M_A/m_R",
        "M_A kg",
        *(f"k_c = {k:g}" for k in grid.k_c_N_per_m),
        "least Re Y, mm/s/N",
        "clew flies it",
    ):
        table.add_column(head, justify="right")
    for i, ratio in enumerate(grid.ratio):
        cells = (_cell(m, i, j, observer, delay) for j in range(len(grid.k_c_N_per_m)))
        allowed = "yes" if RATIO_MIN - 1e-9 <= ratio <= RATIO_MAX + 1e-9 else "refuses"
        table.add_row(f"{ratio:g}", f"{ratio * m.mass_kg:.2f}", *cells, _passivity(m, i, observer, delay), allowed)
    return table


def _cell(m: Flown, i: int, j: int, observer: int, delay: int) -> str:
    std, least = m.tension.std_N[i, j, observer, delay], m.tension.min_N[i, j, observer, delay]
    word, real = verdict(std, least), stability.measured(m, i, j, delay)
    colour = {"calm": "green", "sways": "yellow", "slack": "red"}[word]
    return f"{std:.2f}{f' ({real:g})' if np.isfinite(real) else ''} [{colour}]{word}[/]"


def _passivity(m: Flown, i: int, observer: int, delay: int) -> str:
    """The least Re Y and where it is; negative means that some cable and hand can draw energy from the port."""
    real = m.port.Y_mps_per_N[i, observer, delay].real
    k = int(np.argmin(real))
    word = "[green]passive[/]" if real[k] > NOT_PASSIVE_MPS_PER_N else "[red]active[/]"
    return f"{1e3 * real[k]:.2f} at {m.port.frequency_Hz[k]:.1f} Hz {word}"


def _csv(maps: list[Flown]) -> str:
    """One line a cell."""
    lines = [
        "vehicle,m_R_kg,lead_s,M_A_over_m_R,k_c_N_per_m,observer_Hz,delay_ms,std_N,max_N,min_N,verdict,real_px4_std_N"
    ]
    for m in maps:
        for i, j, o, d in np.ndindex(m.tension.std_N.shape):
            axes = (m.grid.ratio[i], m.grid.k_c_N_per_m[j], m.grid.observer_Hz[o], m.grid.delay_ms[d])
            cell = [float(x[i, j, o, d]) for x in m.tension]
            real = stability.measured(m, i, j, d)
            known = f"{real:g}" if np.isfinite(real) else ""
            numbers = ",".join(f"{x:.6g}" for x in (m.mass_kg, m.lead_s, *axes, *cell))
            lines.append(f"{m.name},{numbers},{verdict(cell[0], cell[2])},{known}")
    return "\n".join(lines) + "\n"
