"""What the vehicle says and what it is told, already in world ENU and body FLU."""

from enum import StrEnum

from schemas.message import Message, Quaternion, Vec3


class ThrustSource(StrEnum):
    """How the thrust in newtons was found; the observer's bias depends on it."""

    ACTUATOR_OUTPUTS = "actuator_outputs"
    ATTITUDE_TARGET = "attitude_target"
    ESC_RPM = "esc_rpm"


class VehicleImu(Message):
    """One inertial sample with the attitude and thrust of the same moment: what the wrench observer needs."""

    specific_force_B_mps2: Vec3
    angular_rate_B_rad_s: Vec3
    q_WB_wxyz: Quaternion
    thrust_N: float
    thrust_source: ThrustSource
    throttle_mean: float = 0.0
    """Of the shares of their range that the motors use, by which thrust is calibrated."""
    throttle_square_mean: float = 0.0
    """Of the squares of these shares."""


class VehicleParameters(Message):
    """The autopilot's own parameters, by its names, as they were when the bridge had connected to it."""

    integers: dict[str, int]
    reals: dict[str, float]


class FlightMode(StrEnum):
    """The autopilot's modes that matter here."""

    OFFBOARD = "offboard"
    HOLD = "hold"
    LAND = "land"
    DESCEND = "descend"
    OTHER = "other"


class VehicleState(Message):
    """Motion and condition of the vehicle as the autopilot estimates them."""

    connected: bool
    armed: bool
    in_air: bool
    mode: FlightMode
    position_m: Vec3
    velocity_mps: Vec3
    q_WB_wxyz: Quaternion
    battery_fraction: float
    battery_V: float = 0.0
    """0: not known."""
    killed: bool = False
    """By a pilot's kill switch, or terminated: no motor turns, and it does not arm."""


class SetpointKind(StrEnum):
    """Which of the bridge's ways of flying produced a set-point."""

    NONE = "none"
    POSITION = "position"
    ADMITTANCE = "admittance"
    EASE = "ease"
    HOLD = "hold"


class Setpoint(Message):
    """What was sent to the autopilot, and the state of the admittance filter behind it.

    `acceleration_mps2` includes the fed-forward cable force; `u_R_mps2` does not. `u_A_N` is what the filter was driven
    with onboard (the spring on its own reference), not the ground's literal one.
    """

    kind: SetpointKind
    position_m: Vec3
    velocity_mps: Vec3
    acceleration_mps2: Vec3
    yaw_rad: float
    u_R_mps2: Vec3
    u_A_N: Vec3
    feed_forward: float
    age_s: float
    """Since the IMU sample behind it, or since the clock tick where no sample is involved."""
