"""The sections of a profile: for each service, the parameters of its laws put together."""

from typing import Any

from services.force_estimator.bias import Bias
from services.force_estimator.observer import Observer
from services.guiding_controller.guiding import Guiding
from services.parameters import NonNegative, Positive, parameters
from services.px4_bridge.admittance import Admittance
from services.px4_bridge.approach import Approach
from services.px4_bridge.flight import Flight
from services.px4_bridge.setpoint import Limits as SetpointLimits
from services.px4_bridge.tank import Tank
from services.px4_bridge.telemetry import Vehicle as Telemetry
from services.px4_bridge.trust import Trust
from services.safety_supervisor.distances import Envelope
from services.safety_supervisor.held import Held
from services.safety_supervisor.phases import Times
from services.safety_supervisor.rules import Limits as SafetyLimits
from services.simulator import flight
from services.simulator.autopilot import Autopilot
from services.simulator.handle import Handle
from services.simulator.human import Event, Human
from services.simulator.imu import Mocap
from services.simulator.px4_sitl import Px4Sitl
from services.simulator.subject import Subject
from services.tracker.axes import Axes
from services.tracker.bodies import CaptureSystem
from services.tracker.filtering import Filter
from services.tracker.robot import Robot

GuidingController = Guiding
Vehicle = flight.Vehicle
PathTable = dict[str, Any]  # checked by guiding_controller/path_file.py


@parameters
class Person:
    """deploy/people/*.toml: who holds the handle, in simulation, and what they will do of their own accord."""

    name: str
    human: Human
    subject: Subject
    behaviour: tuple[Event, ...] = ()


@parameters
class Tracker:
    """Motion capture: where frames come from, and the filters of hand and robot."""

    source: str
    """`simulated`, or the capture system by its name (tracker/bodies.py); `mocap` says the rest of it."""
    handle: Filter
    robot: Robot
    axes: Axes
    fallback_force_min_N: Positive
    mocap: CaptureSystem | None = None


@parameters
class ForceEstimator:
    """Wrench observer and its bias."""

    observer: Observer
    bias: Bias


@parameters
class Link:
    """The autopilot's end."""

    url: str
    timeout_s: Positive
    permit_silent_s: Positive
    """Older than this, the supervisor's word no longer counts and the bridge eases by itself."""
    permit_lost_s: Positive
    """Older than this, the bridge lands by command."""
    force_silent_s: Positive


@parameters
class Px4Bridge:
    """The filter, the way to fly, the link, and how the autopilot must be set: its parameters, by its own names."""

    flight: Flight
    admittance: Admittance
    approach: Approach
    limits: SetpointLimits
    tank: Tank
    vehicle: Telemetry
    link: Link
    trust: Trust
    px4: dict[str, int | float]


@parameters
class SafetySupervisor:
    """Phases, limits, what counts as held, and the route of the landing."""

    times: Times
    limits: SafetyLimits
    envelope: Envelope
    held: Held
    below_m: NonNegative
    """How far under the hand's plane the free handle hangs, so that taking it is lifting it."""
    away_m: Positive
    """How far from the end of the path the vehicle flies before it comes down."""
    aside_m: Positive
    """How far aside it moves once the handle rests on the floor (G10)."""
    ceiling_margin_m: Positive
    """Above the ceiling that the filter keeps, before the supervisor eases."""


@parameters
class Simulator:
    """What only the simulation has: the free handle, the capture system, the stand-in autopilot."""

    handle: Handle
    mocap: Mocap
    mocap_rate_Hz: Positive
    autopilot: Autopilot
    companion: str
    """Where the stand-in sends its MAVLink: host:port."""
    clear_of_start_m: NonNegative
    """Where the subject waits, behind the start of the path."""
    px4_sitl: Px4Sitl | None = None
    """Where a profile has this table, PX4 flies instead of the stand-in."""
