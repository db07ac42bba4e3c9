"""THE table: every topic of the bus, once. Keys, types, rates, QoS, who writes, who listens, what is recorded.

The bus, the freshness checks, the health of a service, the recorder and the documentation are derived from it.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Generic, TypeVar

from schemas.energy import EnergyBalance
from schemas.estimation import CableForce
from schemas.guidance import GuidanceCommand
from schemas.health import Heartbeat
from schemas.message import Message
from schemas.note import OperatorNote
from schemas.radio import RadioClock
from schemas.safety import OperatorReply, OperatorRequest, SafetyState
from schemas.simulation import Truth
from schemas.tracking import HandleState, MocapFrame, RobotPose
from schemas.vehicle import Setpoint, VehicleImu, VehicleParameters, VehicleState

M_co = TypeVar("M_co", bound=Message, covariant=True)


class Stance(Enum):
    """How a topic is carried. Nothing ever blocks its publisher: a blocked put on a dead link stalls local delivery."""

    STREAM = "first: samples and set-points; a radio may lose one, the next follows soon"
    TWICE = (
        "as STREAM, but ahead of it, and where there is a radio again beside the next: lost only if two in a row are"
    )
    STATE = "next, and never lost by a radio that works: verdicts and states"
    COMMAND = "as STATE; its sender repeats it until it is acknowledged"
    BULK = "after everything else: truth, health"


@dataclass(frozen=True)
class Topic(Generic[M_co]):
    """One row of the table. `rate_Hz` 0 means on demand: never stale."""

    key: str
    type: type[M_co]
    publisher: str
    subscribers: tuple[str, ...]
    rate_Hz: float
    stance: Stance
    logged: bool
    about: str
    lifetime_s: float = float("inf")
    """A command older than this when it arrives is refused and counted, not only stale."""
    radio_Hz: float = 0.0
    """As often at most it crosses the radio between two hosts; 0 as often as it is said."""
    packed: bool = False
    """In a system on two hosts: deflated, because it crosses the radio whole and often (runtime/packing.py)."""

    @property
    def timeout_s(self) -> float:
        """Age at which the newest message is stale: ten periods, at least 0.1 s."""
        return max(10.0 / self.rate_Hz, 0.1) if self.rate_Hz else float("inf")


SERVICES = (
    "tracker",
    "force_estimator",
    "guiding_controller",
    "safety_supervisor",
    "px4_bridge",
    "simulator",
    "recorder",
    "drone_gateway",
    "ground_gateway",
)
GATEWAYS = {"drone": "drone_gateway", "ground": "ground_gateway"}
"""Who owns the radio on each host of a system of two; a system on one host has none."""
OPERATOR = "operator"  # a person's console, not a service

# fmt: off
_S, _W, _T, _C, _B = Stance.STREAM, Stance.TWICE, Stance.STATE, Stance.COMMAND, Stance.BULK
#                       key                  type             publisher             subscribers                    rate stance logged
MOCAP_FRAME     = Topic("mocap/frame",       MocapFrame,      "simulator",          ("tracker",),                   60.0, _S, True, "rigid bodies as the simulated capture system sees them")
MOCAP_SEEN      = Topic("mocap/seen",        MocapFrame,      "tracker",            (),                              0.0, _S, True, "as mocap/frame, of a real capture system: its frames as the tracker took them")
HANDLE_STATE    = Topic("handle/state",      HandleState,     "tracker",            ("guiding_controller", "force_estimator", "safety_supervisor", "px4_bridge"), 60.0, _S, True, "p_H, v_H", packed=True)
ROBOT_POSE      = Topic("robot/pose",        RobotPose,       "tracker",            ("px4_bridge", "force_estimator", "safety_supervisor"), 60.0, _S, True, "pose for the autopilot's estimator", packed=True)
VEHICLE_IMU     = Topic("vehicle/imu",       VehicleImu,      "px4_bridge",         ("force_estimator",),          250.0, _S, True, "inertial sample, attitude, thrust", radio_Hz=10.0)
VEHICLE_STATE   = Topic("vehicle/state",     VehicleState,    "px4_bridge",         ("guiding_controller", "safety_supervisor", "tracker"), 50.0, _S, True, "motion, mode, battery", radio_Hz=30.0)
PARAMETERS      = Topic("vehicle/parameters", VehicleParameters, "px4_bridge",       (),                              0.0, _B, True, "the autopilot's own parameters, once, for the recording")
CABLE_FORCE     = Topic("force/cable",       CableForce,      "force_estimator",    ("px4_bridge", "safety_supervisor", "tracker"), 250.0, _S, True, "f̂_c, bias, taut or slack", radio_Hz=25.0)
GUIDANCE        = Topic("guidance/command",  GuidanceCommand, "guiding_controller", ("px4_bridge", "safety_supervisor"), 100.0, _W, True, "p_R^d(s*), f^d(s*), s*", lifetime_s=0.1, packed=True)
SAFETY_STATE    = Topic("safety/state",      SafetyState,     "safety_supervisor",  ("px4_bridge", "guiding_controller", "force_estimator", "simulator"), 50.0, _T, True, "phase, level, permit, reasons", radio_Hz=30.0)
SETPOINT        = Topic("setpoint/sent",     Setpoint,        "px4_bridge",         ("safety_supervisor",),        125.0, _S, True, "what the autopilot was told", radio_Hz=25.0)
ENERGY          = Topic("energy/balance",    EnergyBalance,   "px4_bridge",         ("safety_supervisor",),         50.0, _T, True, "energy through the filter's ports, and the tank", radio_Hz=10.0)
REQUEST         = Topic("@cmd/request",      OperatorRequest, OPERATOR,             ("safety_supervisor", "px4_bridge"), 0.0, _C, True, "a person's command", lifetime_s=1.0)
REPLY           = Topic("safety/reply",      OperatorReply,   "safety_supervisor",  (OPERATOR,),                     0.0, _T, True, "the answer to it")
NOTE            = Topic("operator/note",     OperatorNote,    OPERATOR,             (),                              0.0, _T, True, "a person's remark, for the recording")
TRUTH           = Topic("sim/truth",         Truth,           "simulator",          (),                            100.0, _B, True, "the simulated world as it is")
RADIO_CLOCK     = Topic("radio/clock",       RadioClock,      "drone_gateway",      tuple(name for name in (*SERVICES, OPERATOR) if name != "drone_gateway"), 2.0, _T, True, "how far the hosts' clocks are apart, and the link")
HEALTH          = {name: Topic(f"health/{name}", Heartbeat,   name,                 (OPERATOR,),                     2.0, _B, True, f"the word of {name} about itself") for name in SERVICES}
# fmt: on

TOPICS: tuple[Topic[Message], ...] = (
    MOCAP_FRAME,
    MOCAP_SEEN,
    HANDLE_STATE,
    ROBOT_POSE,
    VEHICLE_IMU,
    VEHICLE_STATE,
    PARAMETERS,
    CABLE_FORCE,
    GUIDANCE,
    SAFETY_STATE,
    SETPOINT,
    ENERGY,
    REQUEST,
    REPLY,
    NOTE,
    TRUTH,
    RADIO_CLOCK,
    *HEALTH.values(),
)
BY_KEY = {topic.key: topic for topic in TOPICS}
