"""Why the vehicle would not fly, or not as it should: an ordered list, each reason with its cure. Pure.

The order is that in which to mend them: what can be said about the vehicle at all, its parameters, its battery.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple, TypeAlias

Number: TypeAlias = int | float

_WHY = {  # what a wrong value does; a parameter that is not here says it in its own documentation
    "COM_OF_LOSS_T": "how long the vehicle flies on without set-points",
    "COM_OBL_RC_ACT": "what it does then: without a remote control anything but Land stays armed, and may climb again",
    "MPC_ACC_DECOUPLE": "with it the sideways pull of the cable is compensated too much",
    "MPC_USE_HTE": "with it the hover thrust learns the pull of the cable",
    "EKF2_EV_CTRL": "whether motion capture is used at all",
    "EKF2_HGT_REF": "with another reference the height drifts",
    "EKF2_EVP_NOISE": "how much motion capture is trusted",
}


class Found(NamedTuple):
    """What the vehicle says; a parameter that it does not have is missing."""

    parameters: Mapping[str, Number]
    armed: bool
    battery_fraction: float


class Reason(NamedTuple):
    """One line, and what to do about it."""

    what: str
    cure: str


def differing(found: Mapping[str, Number], wanted: Mapping[str, Number]) -> dict[str, Number]:
    """The wanted values of all parameters that the vehicle has otherwise; single precision is equal enough."""
    return {
        name: value
        for name, value in wanted.items()
        if name in found and not math.isclose(found[name], value, rel_tol=1e-6, abs_tol=1e-9)
    }


def reasons(found: Found, wanted: Mapping[str, Number], battery_warn_fraction: float) -> list[Reason]:
    """Everything that stands against a flight, in the order in which to mend it; empty is good."""
    listed: list[Reason] = []
    if found.armed:
        listed.append(Reason("the vehicle is armed", "disarm it: nothing is changed on a vehicle with its motors on"))
    for name in wanted:
        if name not in found.parameters:
            listed.append(Reason(f"{name}: the autopilot has no such parameter", "is it PX4, 1.15 or newer?"))
    for name, value in differing(found.parameters, wanted).items():
        why = f" ({_WHY[name]})" if name in _WHY else ""
        listed.append(Reason(f"{name} = {found.parameters[name]:g}, the profile wants {value:g}{why}", "--fix sets it"))
    if found.battery_fraction < battery_warn_fraction:
        charge = (
            f"battery at {100 * found.battery_fraction:.0f} %, at least {100 * battery_warn_fraction:.0f} % to begin"
        )
        listed.append(Reason(charge, "charge it; 0 % may also mean that its charge is not known"))
    return listed
