"""From the autopilot's messages to samples in world ENU and body FLU; no connection, no clock, no thread.

An inertial sample is completed by HIGHRES_IMU: specific force and rate are its own, attitude and thrust are the newest
ones at that moment (at 250 Hz at most 4 ms old). Thrust is what thrust.py makes of the motors' outputs, of their speeds, or
of the thrust in the attitude target; the observer's zeroing takes the rest (G8).
PX4 shows its Descend mode as Land, so DESCEND never appears here.
"""

import math
from collections import deque
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from schemas import frames
from schemas.vehicle import FlightMode, ThrustSource
from services.parameters import Positive, parameters
from services.px4_bridge.thrust import Throttle, Thrust, newtons, throttle

Array = NDArray[np.float64]
Fields: TypeAlias = Mapping[str, Any]

QUEUE_LENGTH = 64  # inertial samples kept for a reader that is late; then the oldest go
_ARMED, _TERMINATED = 128, 8  # MAV_MODE_FLAG, MAV_STATE
_IN_AIR = (2, 3, 4)  # flying, taking off, landing
_MODES = {
    6 << 16: FlightMode.OFFBOARD,
    4 << 16 | 3 << 24: FlightMode.HOLD,
    4 << 16 | 6 << 24: FlightMode.LAND,
}
_NO_CELL = 65535
_RC_RECEIVER, _PREARM = 1 << 16, 1 << 28  # MAV_SYS_STATUS_SENSOR
_POSITION_TIMEOUT_NS = 500_000_000
_FALLBACK_NS = 1_000_000_000  # a vehicle's clock that jumps back by more has been restarted
_CLOCK_LEAK = 1e-4
_LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


@parameters
class Vehicle(Thrust):
    """What has to be known of the vehicle and its messages."""

    motors: Annotated[int, Ge(1)]
    actuator_min: float
    actuator_max: float
    """The motors' range in ACTUATOR_OUTPUT_STATUS, in its own unit."""
    connection_timeout_s: Positive


class ImuSample(NamedTuple):
    """specific_force_B, angular_rate_B (3,) m/s², rad/s; q_WB_wxyz (4,); on the host's clock."""

    stamp_ns: int
    specific_force_B: Array
    angular_rate_B: Array
    q_WB_wxyz: Array
    thrust_N: float
    thrust_source: ThrustSource
    throttle: Throttle


class VehicleSample(NamedTuple):
    """The newest of everything. `stamp_ns` is the position's; positions mean nothing while `has_position` is false."""

    stamp_ns: int
    connected: bool
    armed: bool
    in_air: bool
    mode: FlightMode
    has_position: bool
    p_W: Array
    v_W: Array
    q_WB_wxyz: Array
    battery_fraction: float
    battery_V: float
    """0: not known."""
    killed: bool = False
    """The motors are stopped for as long as a pilot's kill switch is on, or for good."""
    knows_time: bool = True
    """Whether it dates poses by our clock, where it is told."""


class Checks(NamedTuple):
    """What is looked at before a flight: MAV_AUTOPILOT, MAV_TYPE, the version (zeros: not told), and what it says of itself."""

    autopilot: int = 0
    vehicle_type: int = 0
    version: tuple[int, int, int] = (0, 0, 0)
    ready: bool = False
    """Its checks before arming pass, in one bit (SYS_STATUS)."""
    horizontal_m: float = math.inf
    vertical_m: float = math.inf
    """Standard deviations of its position."""
    pilot: bool = False
    """Whether it hears a radio control, and heeds it."""


class Position(NamedTuple):
    """One LOCAL_POSITION_NED in W; m, m/s."""

    stamp_ns: int
    p_W: Array
    v_W: Array


class HostTime:
    """The vehicle's clock mapped onto the host's.

    The shortest way a message has ever taken is the best measure of the clocks' offset; it leaks by 100 µs/s, so that
    drifting clocks are followed. What remains is the shortest delay itself. A vehicle that starts anew is noticed.
    """

    def __init__(self) -> None:
        self._offset_ns = math.inf
        self._last_ns = 0

    def stamp_ns(self, vehicle_ns: int, arrival_ns: int) -> int:
        """When the vehicle's moment was on the host's clock, never later than the arrival."""
        if vehicle_ns < self._last_ns - _FALLBACK_NS:
            self._offset_ns, self._last_ns = math.inf, vehicle_ns
        leaked = self._offset_ns + _CLOCK_LEAK * max(vehicle_ns - self._last_ns, 0)
        self._offset_ns = min(arrival_ns - vehicle_ns, leaked)
        self._last_ns = max(vehicle_ns, self._last_ns)
        return vehicle_ns + int(self._offset_ns)


class Telemetry:
    """Messages in, samples out."""

    def __init__(self, p: Vehicle) -> None:
        self._p = p
        self._time = HostTime()
        self._imu: deque[ImuSample] = deque(maxlen=QUEUE_LENGTH)
        self._q_WB_wxyz: Array | None = None
        self._throttle: Throttle | None = None
        self._position = Position(0, np.zeros(3), np.zeros(3))
        self._position_ns, self._arrival_ns = 0, 0
        self._armed, self._in_air, self._mode, self._killed = False, False, FlightMode.OTHER, False
        self._battery_fraction, self._battery_V = 0.0, 0.0
        self.checks = Checks()
        self.heartbeats, self.statuses = 0, 0
        """How often it has been heard, and how often it has told its mode."""
        self.dropped = 0
        """Inertial samples that nobody fetched in time."""
        self.texts: deque[str] = deque(maxlen=QUEUE_LENGTH)
        """The autopilot's remarks, until somebody takes them."""
        self._takers = {
            "HEARTBEAT": self._take_heartbeat,
            "CURRENT_MODE": self._take_mode,
            "EXTENDED_SYS_STATE": self._take_landed_state,
            "BATTERY_STATUS": self._take_battery,
            "STATUSTEXT": self._take_text,
            "SYS_STATUS": self._take_readiness,
            "ESTIMATOR_STATUS": self._take_accuracy,
            "AUTOPILOT_VERSION": self._take_version,
            "LOCAL_POSITION_NED": self._take_position,
            "ATTITUDE_QUATERNION": self._take_attitude,
            "HIGHRES_IMU": self._take_imu,
            **self._thrust_taker(),
        }

    @property
    def messages(self) -> tuple[str, ...]:
        """The names of the messages that are wanted."""
        return tuple(self._takers)

    def take(self, name: str, fields: Fields, arrival_ns: int) -> None:
        """One message that arrived at `arrival_ns` on the host's clock; names that are not wanted are ignored."""
        self._arrival_ns = arrival_ns
        taker = self._takers.get(name)
        if taker is not None:
            taker(fields, arrival_ns)

    @property
    def has_imu(self) -> bool:
        """Whether there is something to drain."""
        return bool(self._imu)

    def drain(self) -> list[ImuSample]:
        """All inertial samples since the last call, oldest first."""
        samples = list(self._imu)
        self._imu.clear()
        return samples

    def connected(self, now_ns: int) -> bool:
        """Whether the autopilot has been heard of late."""
        return self.heartbeats > 0 and now_ns - self._arrival_ns < 1e9 * self._p.connection_timeout_s

    def sample(self, now_ns: int) -> VehicleSample:
        """The newest of everything; not connected when nothing has come for a while."""
        return VehicleSample(
            stamp_ns=self._position.stamp_ns,
            connected=self.connected(now_ns),
            armed=self._armed,
            in_air=self._in_air,
            mode=self._mode,
            has_position=self._position_ns > 0 and now_ns - self._position_ns < _POSITION_TIMEOUT_NS,
            p_W=self._position.p_W,
            v_W=self._position.v_W,
            q_WB_wxyz=_LEVEL if self._q_WB_wxyz is None else self._q_WB_wxyz,
            battery_fraction=self._battery_fraction,
            battery_V=self._battery_V,
            killed=self._killed,
        )

    def _thrust_taker(self) -> dict[str, Any]:
        match self._p.thrust_source:
            case ThrustSource.ACTUATOR_OUTPUTS:
                return {"ACTUATOR_OUTPUT_STATUS": self._take_outputs}
            case ThrustSource.ATTITUDE_TARGET:
                return {"ATTITUDE_TARGET": self._take_thrust}
            case ThrustSource.ESC_RPM:
                return {"ESC_STATUS": self._take_speeds}

    def _take_heartbeat(self, fields: Fields, _arrival_ns: int) -> None:
        self._take_mode(fields, _arrival_ns)
        self._armed, self._killed = is_armed(fields), fields.get("system_status") == _TERMINATED
        self.checks = self.checks._replace(autopilot=fields.get("autopilot", 0), vehicle_type=fields.get("type", 0))
        self.heartbeats += 1

    def _take_mode(self, fields: Fields, _arrival_ns: int) -> None:
        """A heartbeat comes once a second; where there is CURRENT_MODE it tells a change at once."""
        self._mode = mode_of(fields)
        self.statuses += 1

    def _take_landed_state(self, fields: Fields, _arrival_ns: int) -> None:
        self._in_air = fields["landed_state"] in _IN_AIR

    def _take_battery(self, fields: Fields, _arrival_ns: int) -> None:
        self._battery_fraction = max(fields["battery_remaining"], 0) / 100.0  # -1: unknown, shown as empty
        self._battery_V = sum(cell for cell in fields.get("voltages", ()) if cell != _NO_CELL) / 1000.0

    def _take_text(self, fields: Fields, _arrival_ns: int) -> None:
        self.texts.append(fields["text"])

    def _take_readiness(self, fields: Fields, _arrival_ns: int) -> None:
        ready, pilot = fields["onboard_control_sensors_health"], fields.get("onboard_control_sensors_present", 0)
        self.checks = self.checks._replace(ready=bool(ready & _PREARM), pilot=bool(pilot & _RC_RECEIVER))

    def _take_accuracy(self, fields: Fields, _arrival_ns: int) -> None:
        stated = (fields["pos_horiz_accuracy"], fields["pos_vert_accuracy"])
        horizontal_m, vertical_m = (math.inf if x is None or math.isnan(x) else float(x) for x in stated)
        self.checks = self.checks._replace(horizontal_m=horizontal_m, vertical_m=vertical_m)

    def _take_version(self, fields: Fields, _arrival_ns: int) -> None:
        packed = fields["flight_sw_version"]
        self.checks = self.checks._replace(version=(packed >> 24 & 255, packed >> 16 & 255, packed >> 8 & 255))

    def _take_position(self, fields: Fields, arrival_ns: int) -> None:
        stamp_ns = self._time.stamp_ns(1_000_000 * fields["time_boot_ms"], arrival_ns)
        position, velocity = _three(fields, "x", "y", "z"), _three(fields, "vx", "vy", "vz")
        if all(map(math.isfinite, (*position, *velocity))):
            p_W, v_W = frames.enu_from_ned(np.array((position, velocity)))
            self._position, self._position_ns = Position(stamp_ns, p_W, v_W), arrival_ns

    def _take_attitude(self, fields: Fields, _arrival_ns: int) -> None:
        q_NED_FRD = np.array((fields["q1"], fields["q2"], fields["q3"], fields["q4"]))
        self._q_WB_wxyz = frames.q_enu_flu_from_ned_frd(q_NED_FRD)

    def _take_outputs(self, fields: Fields, _arrival_ns: int) -> None:
        p = self._p
        span = p.actuator_max - p.actuator_min
        self._throttle = throttle([(u - p.actuator_min) / span for u in fields["actuator"][: p.motors]])

    def _take_thrust(self, fields: Fields, _arrival_ns: int) -> None:
        self._throttle = throttle([fields["thrust"]])

    def _take_speeds(self, fields: Fields, _arrival_ns: int) -> None:
        """Four motors a message, the first of which is `index`; a vehicle has them all in the first."""
        if fields["index"] == 0:
            self._throttle = throttle([abs(rpm) / self._p.rpm_max for rpm in fields["rpm"][: self._p.motors]])

    def _take_imu(self, fields: Fields, arrival_ns: int) -> None:
        if fields["id"] != 0 or self._q_WB_wxyz is None or self._throttle is None:
            return
        self.dropped += len(self._imu) == QUEUE_LENGTH
        stamp_ns = self._time.stamp_ns(1000 * fields["time_usec"], arrival_ns)
        felt = np.array((_three(fields, "xacc", "yacc", "zacc"), _three(fields, "xgyro", "ygyro", "zgyro")))
        force, rate = frames.flu_from_frd(felt)
        thrust_N = newtons(self._throttle, self._battery_V, self._p)
        self._imu.append(
            ImuSample(stamp_ns, force, rate, self._q_WB_wxyz, thrust_N, self._p.thrust_source, self._throttle)
        )


def _three(fields: Fields, x: str, y: str, z: str) -> tuple[float, float, float]:
    return fields[x], fields[y], fields[z]


def mode_of(heartbeat: Fields) -> FlightMode:
    """The mode in a HEARTBEAT or CURRENT_MODE."""
    return _MODES.get(heartbeat["custom_mode"], FlightMode.OTHER)


def is_armed(heartbeat: Fields) -> bool:
    """What a HEARTBEAT says of it."""
    return bool(heartbeat["base_mode"] & _ARMED)
