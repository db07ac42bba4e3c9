"""What a calibration found: one TOML file with a table for each kind, its residual and where it comes from.

layer.py says which of its values go where in a profile.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

from schemas.vehicle import ThrustSource
from services.parameters import NonNegative, Positive, parameters

THRUST_ERROR_MAX = 0.02
"""5 % of thrust is already 0.4 to 0.8 N of bias (G8)."""


@parameters
class Found:
    """How good it is, and where it comes from."""

    date: str
    recording: str
    """The files it was found in, or how long was listened to a living system."""
    recorded_by: str
    found_by: str
    """Versions of Clew."""
    seconds: NonNegative
    residual: NonNegative
    residual_max: Positive
    residual_unit: str
    condition: Positive


@parameters
class ThrustResult:
    """Of thrust.py in px4_bridge, between `low_N` and `high_N`; `lag_s` is the motors'."""

    thrust_source: ThrustSource
    max_thrust_N: Positive
    thrust_curve: float
    thrust_error: NonNegative
    voltage_exponent: NonNegative
    reference_V: Positive
    rpm_max: Positive
    lag_s: NonNegative
    low_N: float
    high_N: float
    found: Found


@parameters
class MassResult:
    """m_R; `thrust_scale` is the factor on the thrust model that the same flights showed, 1 where it was taken as known."""

    m_R_kg: Positive
    sigma_kg: NonNegative
    thrust_scale: Positive
    found: Found


@parameters
class HandleResult:
    """O_H in the frame of the handle's markers."""

    offset_m: tuple[float, float, float]
    found: Found


@parameters
class DelayResult:
    """How much older a pose is than its stamp."""

    delay_s: float
    sigma_s: NonNegative
    found: Found


@parameters
class Calibration:
    """All that has been found for a vehicle and a laboratory."""

    thrust: ThrustResult | None = None
    mass: MassResult | None = None
    handle: HandleResult | None = None
    delay: DelayResult | None = None


Result = ThrustResult | MassResult | HandleResult | DelayResult


def kind_of(result: Result) -> str:
    """Its table's name in the file."""
    return type(result).__name__.removesuffix("Result").lower()


def write(file: Path, result: Result) -> None:
    """Put one kind's table into the file; the others stay as they are. Raises OSError, tomllib.TOMLDecodeError."""
    tables: dict[str, Any] = tomllib.loads(file.read_text()) if file.exists() else {}
    tables[kind_of(result)] = asdict(result)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("# Written by clew calibrate; see docs/operate.md.\n" + "".join(_lines(tables)))


def _lines(tables: Mapping[str, Any], above: str = "") -> list[str]:
    lines = list[str]()
    for name, table in tables.items():
        inner: dict[str, Any] = {key: value for key, value in table.items() if isinstance(value, dict)}
        lines.append(f"\n[{above}{name}]\n")
        lines += [f"{key} = {_toml(value)}\n" for key, value in table.items() if key not in inner]
        lines += _lines(inner, f"{above}{name}.")
    return lines


def _toml(value: Any) -> str:
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(_toml(each) for each in cast('list[Any]', value))}]"
    if isinstance(value, str):
        escaped = str(value).replace("\\", "\\\\").replace('"', '\\"')
        return f'"{escaped}"'
    return f"{value:.6g}" if isinstance(value, float) else str(value)
