"""A population: how the people of a campaign differ, and how each of their walks does, read from deploy/populations/*.toml.

A file gives each quantity of `Human` and of `Trial` once: under [person] it is drawn once for a person, under [trial] anew
for each walk. A quantity is a number; a list, of which person (or walk) number i gets entry i, round and round;
`{ low, high }`, even between the two; or `{ mean, std, low, high }`, normal and cut off at the two.

Pure: the numbers that decide, even in [0, 1), come from outside. The limits stand in the types of `Human` and `Trial`.
"""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path as File
from typing import Any, TypeAlias, cast, get_type_hints

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from services.campaign.walk import People
from services.parameters import Fraction, NonNegative, Positive, parameters
from services.physics import GRAVITY_MPS2, Array
from services.simulator.human import Event, Human, Kind


@parameters
class Trial:
    """What differs from walk to walk: where it starts, and whether and when the person stops, or pushes to their left."""

    start_aside_m: float
    stop_probability: Fraction
    stop_start_s: NonNegative
    stop_duration_s: Positive
    push_probability: Fraction
    push_start_s: NonNegative
    push_duration_s: Positive
    push_aside_N: float


Columns: TypeAlias = dict[str, Array]
"""One array (N,) for each quantity, one entry for each walk; and the numbers of `person` and `trial`, from 1."""

WHY = {
    "m_H_kg": "everybody has a mass",
    "b_H_Ns_per_m": "B_H must be positive definite",
    "reaction": "nobody pulls the drone along by being pulled",
}


@dataclass(frozen=True)
class Spread:
    """How one quantity is spread; `std` 0 means evenly between `low` and `high`, and `values` win over both."""

    low: float
    high: float
    mean: float = 0.0
    std: float = 0.0
    values: tuple[float, ...] = ()

    def at(self, u: Array, number: NDArray[np.int64]) -> Array:
        """The values (N,) that u (N,) in [0, 1) decides for the ones numbered `number` (N,), from 0."""
        if self.values:
            return np.array(self.values)[number % len(self.values)]
        if not self.std:
            return self.low + u * (self.high - self.low)
        first, last = ndtr((self.low - self.mean) / self.std), ndtr((self.high - self.mean) / self.std)
        return np.clip(self.mean + self.std * ndtri(first + u * (last - first)), self.low, self.high)


@dataclass(frozen=True)
class Population:
    """The spreads of the persons and of the trials by quantity."""

    name: str
    person: Mapping[str, Spread]
    trial: Mapping[str, Spread]


def limits(kind: type) -> dict[str, tuple[Any, ...]]:
    """The limits of each numeric parameter of a law, from its types."""
    hints = get_type_hints(kind, include_extras=True)
    return {name: getattr(hint, "__metadata__", ()) for name, hint in hints.items()}


QUANTITIES = limits(Human) | limits(Trial)
DEEDS = ("stop", "push")
UNIFORMS = len(QUANTITIES) + len(DEEDS)
"""How many numbers decide about a person, or a walk."""


def read(file: File) -> Population:
    """The population in `file`. Raises ValueError: file, key, value, limit, one line."""
    try:
        return build(tomllib.loads(file.read_text(encoding="utf-8")))
    except (ValueError, OSError) as error:
        raise ValueError(f"{file}: {error}") from None


def build(table: Mapping[str, Any]) -> Population:
    """The population of a file's content; ValueError as `read`, without the file."""
    for key in table.keys() - {"name", "person", "trial"}:
        raise ValueError(f"{key} = {table[key]!r}: is not a known key")
    parts = {part: _spreads(part, table.get(part, {})) for part in ("person", "trial")}
    for name in QUANTITIES:
        times = sum(name in part for part in parts.values())
        if times != 1:
            raise ValueError(f"{name}: is {'missing' if not times else 'there twice'}, in [person] or in [trial]")
    return Population(str(table.get("name", "")), **parts)


def _spreads(part: str, table: Any) -> dict[str, Spread]:
    if not isinstance(table, dict):
        raise ValueError(f"{part} = {table!r}: must be a table")
    spreads: dict[str, Spread] = {}
    for name, value in cast("dict[str, Any]", table).items():
        if name not in QUANTITIES:
            raise ValueError(f"{part}.{name} = {value!r}: is not a known key")
        spreads[name] = spread(f"{part}.{name}", value, QUANTITIES[name], WHY.get(name, ""))
    return spreads


def spread(key: str, value: Any, within: Sequence[Any], why: str = "") -> Spread:
    """The spread that `value` says, all of it within the limits; ValueError names the key, the value and the limit."""
    made = _made(key, value)
    for x in (*made.values, made.low, made.high):
        for limit in within:
            if broken := _broken(x, limit):
                raise ValueError(f"{key} = {x:g}: must be {broken}" + (f": {why}" if why else ""))
    return made


def _made(key: str, value: Any) -> Spread:
    if isinstance(value, dict):
        given = {str(name): _number(f"{key}.{name}", x) for name, x in cast("dict[str, Any]", value).items()}
        if set(given) not in ({"low", "high"}, {"mean", "std", "low", "high"}):
            raise ValueError(f"{key} = {value!r}: low and high are needed, and mean and std or neither")
        made = Spread(given["low"], given["high"], given.get("mean", 0.0), given.get("std", 0.0))
        if not made.low <= made.high:
            raise ValueError(f"{key}.low = {made.low:g}: must be at most high = {made.high:g}")
        if "std" in given and not made.std > 0.0:
            raise ValueError(f"{key}.std = {made.std:g}: must be > 0")
        return made
    values = tuple(_number(key, x) for x in cast("list[Any]", value if isinstance(value, list) else [value]))
    if not values:
        raise ValueError(f"{key} = []: at least one value is needed")
    return Spread(min(values), max(values), values=values)


def _number(key: str, x: Any) -> float:
    if isinstance(x, bool) or not isinstance(x, (int, float)) or not np.isfinite(x):
        raise ValueError(f"{key} = {x!r}: a finite number is needed")
    return float(x)


def _broken(x: float, limit: Any) -> str:
    """The limit in words if `x` breaks it."""
    match limit:
        case Gt(gt=bound) if not x > cast(float, bound):
            return f"> {bound}"
        case Ge(ge=bound) if not x >= cast(float, bound):
            return f">= {bound}"
        case Le(le=bound) if not x <= cast(float, bound):
            return f"<= {bound}"
        case _:
            return ""


def draw(population: Population, u_person: Array, u_trial: Array) -> Columns:
    """The walks of P persons with M trials each, person by person, N = P M, from u_person (P, Q) and u_trial (P, M, Q).

    Q is UNIFORMS; quantity number q, in the order of QUANTITIES, takes column q, and whether a deed is done the rest. Who
    does not do it starts at infinity.
    """
    persons, trials, _ = u_trial.shape
    walk: NDArray[np.int64] = np.arange(persons * trials, dtype=np.int64)
    columns: Columns = {"person": walk // trials + 1.0, "trial": walk % trials + 1.0}
    for q, name in enumerate(QUANTITIES):
        if name in population.person:
            columns[name] = np.repeat(
                population.person[name].at(u_person[:, q], np.arange(persons, dtype=np.int64)), trials
            )
        else:
            columns[name] = population.trial[name].at(u_trial[..., q].ravel(), walk)
    for i, deed in enumerate(DEEDS):
        does = u_trial[..., len(QUANTITIES) + i].ravel() < columns[f"{deed}_probability"]
        columns[f"{deed}_start_s"] = np.where(does, columns[f"{deed}_start_s"], np.inf)
    return columns


def check(columns: Columns, f_z_N: Array) -> None:
    """Raise ValueError, with the first person's number, unless f_z < m_H g for everyone: the ground must hold them."""
    weight = columns["m_H_kg"] * GRAVITY_MPS2
    for i in np.flatnonzero(f_z_N >= weight)[:1]:
        who = f"person {columns['person'][i]:.0f} with m_H = {columns['m_H_kg'][i]:.3g} kg"
        raise ValueError(
            f"f_z_N = {np.broadcast_to(f_z_N, weight.shape)[i]:g}: must be below m_H g = {weight[i]:.2f} N of {who}"
        )


def people(columns: Columns, which: slice | int, left_W: Array) -> People:
    """The people of some of the walks, or of one, on floats; they push towards `left_W` (3,)."""
    x = {name: some(columns[name], which) for name in QUANTITIES}
    push_W = (float(left_W[0]) * x["push_aside_N"], float(left_W[1]) * x["push_aside_N"], 0.0)
    stop = Event(kind=Kind.STOP, start_s=x["stop_start_s"], duration_s=x["stop_duration_s"])
    push = (
        [Event(kind=Kind.PUSH, start_s=x["push_start_s"], duration_s=x["push_duration_s"], force_W_N=push_W)]
        if any(np.any(force) for force in push_W)
        else []
    )
    human = Human(**{name: x[name] for name in limits(Human)})
    return People(human=human, behaviour=(stop, *push), start_aside_m=x["start_aside_m"])


def some(column: Array, which: slice | int) -> Any:
    """Entries of a column: an array of them, or a float."""
    return column[which] if isinstance(which, slice) else float(column[which])
