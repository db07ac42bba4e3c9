"""What a campaign varies beyond its population: `--vary m_H=2..12,k_c=100,200,400,delay_ms=0..80`.

A range `a..b` is spread over the persons so that each part of it has its share (a Latin hypercube), and the entries of a list
are shared out equally; either way in an order of its own for each quantity, and alike for all walks of a person.
"""

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any, NamedTuple

import numpy as np
from annotated_types import Ge, Le

from services.cable import Cable
from services.campaign.population import QUANTITIES, WHY, Columns, Spread, limits, some, spread
from services.campaign.walk import CONTROL_S, Experiment
from services.guiding_controller.guiding import Guiding
from services.physics import Array
from services.px4_bridge.admittance import Admittance


class Variable(NamedTuple):
    """A quantity by its short name: the column it goes to, and its limits."""

    column: str
    within: tuple[Any, ...]


def _short(name: str) -> str:
    """`m_H` of `m_H_kg`: without the unit."""
    units = ("_kg", "_Ns_per_m", "_N_per_m", "_N", "_m", "_s")
    return next((name.removesuffix(unit) for unit in units if name.endswith(unit)), name)


_OF_LAWS = {
    name: limits(kind)[name]
    for kind, names in (
        (Cable, ("k_c_N_per_m", "d_c_Ns_per_m")),
        (Guiding, ("f_z_N", "k_H_N_per_m")),
        (Admittance, ("M_A_kg", "b_A_Ns_per_m")),
    )
    for name in names
}
VARIABLES = {_short(name): Variable(name, within) for name, within in (QUANTITIES | _OF_LAWS).items()}
VARIABLES["delay_ms"] = Variable("delay_ms", (Ge(0.0), Le(1000.0)))


def parse(text: str) -> dict[str, Spread]:
    """The spreads by short name; ValueError names what cannot be read, in one line."""
    spreads: dict[str, Spread] = {}
    for part in _parts(text):
        name, _, values = part.partition("=")
        if name not in VARIABLES:
            raise ValueError(f"--vary {name}: must be one of {', '.join(sorted(VARIABLES))}")
        key = f"--vary {name}"
        spreads[name] = spread(key, _value(key, values), VARIABLES[name].within, WHY.get(VARIABLES[name].column, ""))
    return spreads


def _parts(text: str) -> list[str]:
    """`a=1,2,b=3` taken apart before each name."""
    parts: list[str] = []
    for piece in filter(None, (piece.strip() for piece in text.split(","))):
        if "=" in piece:
            parts.append(piece)
        elif parts:
            parts[-1] += "," + piece
        else:
            raise ValueError(f"--vary {piece}: a name and = are needed first, as in m_H=2..12")
    return parts


def _value(key: str, text: str) -> Any:
    try:
        if ".." in text:
            low, high = text.split("..")
            return {"low": float(low), "high": float(high)}
        return [float(x) for x in text.split(",")]
    except ValueError:
        raise ValueError(f"{key} = {text!r}: must be a range as 2..12, or values as 100,200") from None


def draw(spreads: Mapping[str, Spread], u: Array, trials: int) -> Columns:
    """Columns (P M,) from u (P, 2 V), where V is the number of spreads."""
    columns: Columns = {}
    for v, (name, made) in enumerate(spreads.items()):
        place = np.argsort(u[:, 2 * v], kind="stable")
        values = made.at((place + u[:, 2 * v + 1]) / len(u), place)
        if name == "delay_ms":
            values = np.round(values / (1e3 * CONTROL_S)) * (1e3 * CONTROL_S)  # whole control ticks
        columns[VARIABLES[name].column] = np.repeat(values, trials)
    return columns


def experiment(base: Experiment, columns: Columns, which: slice | int) -> Experiment:
    """What these walks are walked with: `base`, and what the columns say otherwise."""
    given = {name: some(columns[name], which) for name in _OF_LAWS if name in columns}
    delay_ms: Array = columns.get("delay_ms", np.zeros(len(columns["person"])))
    delay = np.round(np.asarray(some(delay_ms, which)) / (1e3 * CONTROL_S))
    changed = replace(
        base,
        cable=_with(base.cable, given),
        guiding=_with(base.guiding, given),
        filter=_with(base.filter, given),
        delay_ticks=delay,
    )
    return changed if isinstance(which, int) else _dense(changed, which.stop - which.start)


def _dense(x: Experiment, n: int) -> Experiment:
    """With what the quickest loop uses as arrays (n,): numpy is slower on an array and a float than on two arrays."""
    line = {name: np.full(n, value) for name, value in asdict(x.cable).items()}
    return replace(
        x, cable=replace(x.cable, **line), filter=replace(x.filter, e_R_max_m=np.full(n, x.filter.e_R_max_m))
    )


def _with(parameters: Any, given: Mapping[str, Any]) -> Any:
    return replace(parameters, **{name: x for name, x in given.items() if hasattr(parameters, name)})
