"""`clew calibrate ...`: the command's words."""

import math
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer()


class Calibrated(StrEnum):
    """What can be calibrated."""

    THRUST = "thrust"
    MASS = "mass"
    HANDLE = "handle"
    DELAY = "delay"


@app.command()
def calibrate(
    what: Calibrated,
    recordings: Annotated[
        list[Path] | None,
        typer.Argument(help="session.mcap or its folder; without one the living system is listened to"),
    ] = None,
    profile: Annotated[str, typer.Option(help="a name in deploy/profiles, or a file")] = "demo",
    seconds: Annotated[float, typer.Option(help="of listening to a living system")] = 30.0,
    out: Annotated[Path | None, typer.Option(help="the TOML; by default the one of system.calibration")] = None,
    mass_kg: Annotated[
        float, typer.Option(help="thrust: the vehicle as it flies, weighed; the profile's by default")
    ] = math.nan,
    hanging_kg: Annotated[float, typer.Option(help="on the cable; the profile's handle by default")] = math.nan,
    added_kg: Annotated[
        list[float] | None, typer.Option(help="mass: fixed to the vehicle, once for each recording")
    ] = None,
) -> None:
    """Find the numbers of this vehicle and laboratory from a flight, with their residual, and keep them."""
    from services.console import calibrate as calibration

    asked = calibration.Asked(
        kind=what.value,
        profile=profile,
        recordings=recordings or [],
        seconds=seconds,
        out=out,
        mass_kg=mass_kg,
        hanging_kg=hanging_kg,
        added_kg=added_kg or [],
    )
    raise typer.Exit(calibration.calibrate(asked))
