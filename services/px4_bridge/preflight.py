"""Why the vehicle would not fly, or not as it should: an ordered list, each reason with its cure. Pure.

The order is that in which to mend them: what can be said about the vehicle at all, its parameters, its sensors and its estimate,
its own checks before arming, the thrust model, its battery.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeAlias

from schemas.vehicle import ThrustSource
from services.physics import GRAVITY_MPS2

Number: TypeAlias = int | float

PX4, QUADROTOR = 12, 2
"""MAV_AUTOPILOT and MAV_TYPE."""
OLDEST = (1, 15, 0)
"""CURRENT_MODE and the parameters' names are those of then."""
LAND = 4
"""COM_OBL_RC_ACT."""
NOBODY = 4
"""COM_RC_IN_MODE."""
KILL_SWITCH = "RC_MAP_KILL_SW"
"""Its channel is the radio control's own, so no profile wants one."""
LOSS_MAX_S = 1.0
ESTIMATE_MAX_M = 0.05
"""Standard deviation of the position; motion capture gives a tenth of it."""
THRUST_ERROR_MAX = 0.02
"""As calibration has it: 5 % of thrust is 0.4 to 0.8 N of bias (G8)."""

_WHY = {  # what a wrong value does; a parameter that is not here says it in its own documentation
    "COM_OF_LOSS_T": "how long the vehicle flies on without set-points",
    "COM_KILL_DISARM": "for how long the way back of a pilot's kill switch starts the motors again",
    "COM_RC_IN_MODE": "whether it heeds a pilot's radio control, kill switch included",
    "COM_OBL_RC_ACT": "what it does then: without a remote control anything but Land stays armed, and may climb again",
    "MPC_ACC_DECOUPLE": "with it the sideways pull of the cable is compensated too much",
    "MPC_USE_HTE": "with it the hover thrust learns the pull of the cable",
    "EKF2_EV_CTRL": "whether motion capture is used at all",
    "EKF2_HGT_REF": "with another reference the height drifts",
    "EKF2_BARO_CTRL": "without it a vehicle that loses its poses does not feel the ground, and stays armed on it",
    "EKF2_EVP_NOISE": "how much motion capture is trusted",
    "EKF2_EV_DELAY": "how old poses are",
}


class Identity(NamedTuple):
    """Who answers: MAV_AUTOPILOT, MAV_TYPE, and the version of its software, zeros where it does not say."""

    autopilot: int
    vehicle_type: int
    version: tuple[int, int, int]


class Estimate(NamedTuple):
    """Standard deviations of its position in m, as it states them; `known` once it has a position and states them."""

    known: bool
    horizontal_m: float
    vertical_m: float


class Thrust(NamedTuple):
    """The model by which the observer knows thrust: its source, its stated error, whether it had to be and was calibrated."""

    source: ThrustSource
    error: float
    simulated: bool
    calibrated: bool


class Found(NamedTuple):
    """What the vehicle says; a parameter that it does not have is missing."""

    identity: Identity
    parameters: Mapping[str, Number]
    refused: Sequence[str]
    """What it would not let be set."""
    armed: bool
    specific_force_mps2: float
    """Mean length, at rest; 0 where no inertial sample came."""
    poses: int
    """How many of motion capture it was given meanwhile."""
    estimate: Estimate
    arming: Sequence[str]
    """What it has against arming in offboard mode, in its own words."""
    battery_fraction: float
    pilot: bool
    """Whether it hears a radio control that it heeds."""


class Wanted(NamedTuple):
    """How it has to be."""

    parameters: Mapping[str, Number]
    thrust: Thrust
    mass_kg: float
    bias_max_N: float
    """What zeroing may find (tare_bias_max_N)."""
    battery_warn_fraction: float


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


def heeds_a_pilot(wanted: Mapping[str, Number]) -> bool:
    """Whether the profile has PX4 listen to a radio control."""
    return wanted.get("COM_RC_IN_MODE", NOBODY) != NOBODY


def reasons(found: Found, wanted: Wanted) -> list[Reason]:
    """Everything that stands against a flight, in the order in which to mend it; empty is good."""
    return [
        *kind(found.identity.autopilot, found.identity.vehicle_type),
        *_version(found.identity.version),
        *_armed(found),
        *_parameters(found, wanted.parameters),
        *_pilot(found, wanted.parameters),
        *_sensors(found, wanted),
        *_estimate(found),
        *(Reason(f"PX4: {problem}", "its own check before arming") for problem in found.arming),
        *_thrust(wanted),
        *_battery(found, wanted.battery_warn_fraction),
    ]


def kind(autopilot: int, vehicle_type: int) -> list[Reason]:
    """What it must be, whatever its version: MAV_AUTOPILOT and MAV_TYPE."""
    listed: list[Reason] = []
    if autopilot != PX4:
        listed.append(Reason(f"the autopilot is no PX4 (MAV_AUTOPILOT = {autopilot})", "only PX4 is flown"))
    if vehicle_type != QUADROTOR:
        told = f"the vehicle is no quadrotor (MAV_TYPE = {vehicle_type}, must be {QUADROTOR})"
        listed.append(Reason(told, "is px4_bridge.link.url the right vehicle's, and its airframe (SYS_AUTOSTART) set?"))
    return listed


def _version(version: tuple[int, int, int]) -> list[Reason]:
    if version >= OLDEST:
        return []
    told = ".".join(map(str, version)) if any(version) else "not told"
    return [Reason(f"PX4's version is {told}, at least {'.'.join(map(str, OLDEST))}", "install a newer one")]


def _armed(found: Found) -> list[Reason]:
    cure = "disarm it: nothing is changed on a vehicle with its motors on"
    return [Reason("the vehicle is armed", cure)] if found.armed else []


def _parameters(found: Found, wanted: Mapping[str, Number]) -> list[Reason]:
    listed = [Reason(refusal, "the profile is for another version of PX4") for refusal in found.refused]
    for name in wanted:
        if name not in found.parameters:
            listed.append(Reason(f"{name}: the autopilot has no such parameter", "is it PX4, 1.15 or newer?"))
    for name, value in differing(found.parameters, wanted).items():
        why = f" ({_WHY[name]})" if name in _WHY else ""
        listed.append(Reason(f"{name} = {found.parameters[name]:g}, the profile wants {value:g}{why}", "--fix sets it"))
    if wanted.get("COM_OBL_RC_ACT") != LAND:
        told = f"the profile's COM_OBL_RC_ACT = {wanted.get('COM_OBL_RC_ACT', 'nothing')}: must be {LAND}, Land"
        listed.append(Reason(told, "px4_bridge.px4: with anything else it may climb again when set-points are back"))
    if not 0.0 < wanted.get("COM_OF_LOSS_T", math.inf) <= LOSS_MAX_S:
        told = (
            f"the profile's COM_OF_LOSS_T = {wanted.get('COM_OF_LOSS_T', 'nothing')}: must be at most {LOSS_MAX_S:g} s"
        )
        listed.append(Reason(told, "px4_bridge.px4: it flies on for that long without set-points"))
    return listed


def _pilot(found: Found, wanted: Mapping[str, Number]) -> list[Reason]:
    """A kill switch at a radio control that is on: PX4 arms and flies without either."""
    if not heeds_a_pilot(wanted):
        return []
    listed: list[Reason] = []
    if not found.parameters.get(KILL_SWITCH):
        cure = "a ground station's radio setup chooses one; then try it on the ground"
        listed.append(Reason(f"{KILL_SWITCH} = 0: no channel of the radio control is a kill switch", cure))
    if not found.pilot:
        listed.append(Reason("PX4 hears no pilot's radio control", "switch it on; is it bound and calibrated?"))
    return listed


def _sensors(found: Found, wanted: Wanted) -> list[Reason]:
    """At rest the accelerometer feels g; what is missing is a bias of the force estimate, which zeroing must be able to take."""
    if found.specific_force_mps2 == 0.0:
        return [Reason("no inertial samples", "HIGHRES_IMU must get through: baud rate, MAV_n_RATE")]
    bias_N = wanted.mass_kg * abs(found.specific_force_mps2 - GRAVITY_MPS2)
    if bias_N <= wanted.bias_max_N / 2 or found.armed:
        return []
    told = f"at rest the accelerometer reads {found.specific_force_mps2:.2f} m/s²: {bias_N:.2f} N of bias"
    return [
        Reason(told, f"at most {wanted.bias_max_N / 2:g} N, half of what zeroing takes: calibrate it, stand it still")
    ]


def _estimate(found: Found) -> list[Reason]:
    if not found.poses:
        return [Reason("no poses from motion capture: it cannot know where it is", "start the capture system")]
    estimate = found.estimate
    if not estimate.known:
        return [Reason("the autopilot has no position", "is the capture system's frame right? EKF2_EV_CTRL set?")]
    worst_m = max(estimate.horizontal_m, estimate.vertical_m)
    if worst_m <= ESTIMATE_MAX_M:
        return []
    told = f"its position is uncertain by {estimate.horizontal_m:.3f} m, height by {estimate.vertical_m:.3f} m"
    return [Reason(told, f"at most {ESTIMATE_MAX_M:g} m: wait, or look at motion capture's rate and EKF2_EV_DELAY")]


def _thrust(wanted: Wanted) -> list[Reason]:
    thrust = wanted.thrust
    if not (thrust.simulated or thrust.calibrated):
        return [Reason(f"thrust by {thrust.source} is not calibrated", "clew calibrate thrust")]
    if thrust.error > THRUST_ERROR_MAX:
        told = f"thrust by {thrust.source} is wrong by {100 * thrust.error:.1f} %, at most {100 * THRUST_ERROR_MAX:g} %"
        return [Reason(f"{told} ({thrust.error * wanted.mass_kg * GRAVITY_MPS2:.2f} N)", "clew calibrate thrust")]
    return []


def _battery(found: Found, warn_fraction: float) -> list[Reason]:
    if found.battery_fraction >= warn_fraction:
        return []
    charge = f"battery at {100 * found.battery_fraction:.0f} %, at least {100 * warn_fraction:.0f} % to begin"
    return [Reason(charge, "charge it; 0 % may also mean that its charge is not known")]
