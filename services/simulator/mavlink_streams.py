"""What the stand-in autopilot sends, message by message, in MAVLink's frames and units.

Rates are PX4's defaults for a companion's link, but for the set-points in force, which it shows to nobody who has not
asked. Whoever wants more asks for it with MAV_CMD_SET_MESSAGE_INTERVAL, and gets no more than PX4 gives. Motor outputs
are whole microseconds of PWM.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from schemas import frames
from services.simulator.autopilot import AutopilotState, Sensors
from services.simulator.commander import CommanderState, Mode

CUSTOM_MODE = {  # PX4's main mode << 16 | sub mode << 24; it shows Descend as Land
    Mode.OFFBOARD: 6 << 16,
    Mode.HOLD: 4 << 16 | 3 << 24,
    Mode.LAND: 4 << 16 | 6 << 24,
    Mode.DESCEND: 4 << 16 | 6 << 24,
}
QUADROTOR, PX4 = 2, 12
VERSION = 0x011100FF
"""1.17.0, as packed."""
_CUSTOM_MODE_ENABLED, _ARMED = 1, 128
_STANDBY, _ACTIVE, _TERMINATED = 3, 4, 8  # MAV_STATE
_ON_GROUND, _IN_AIR = 1, 2
_BATTERY_CELL_V = 3.5
_NOT_SET = 65535
_ATTITUDE_QUATERNION, _ACTUATOR_OUTPUT_STATUS, _HIGHRES_IMU, _LOCAL_POSITION_NED = 31, 375, 105, 32
_CURRENT_MODE = 436
PREARM = 1 << 28
_ESTIMATES = 0x1F  # attitude, velocity and position
_ACCURACY_M, _DRIFT_MPS = 0.005, 0.1
_UNUSED_OUTPUTS = (0.0,) * 28
_ACCEPTED_FIELDS = 63  # accelerometer and gyro are new in this sample


class Moment(NamedTuple):
    """All that a message can be made from; the time is the vehicle's own."""

    state: AutopilotState
    sensors: Sensors
    time_us: int


def _heartbeat(mav: Any, now: Moment) -> None:
    orders = now.state.commander
    base = _CUSTOM_MODE_ENABLED | (_ARMED if orders.armed else 0)
    mav.heartbeat_send(QUADROTOR, PX4, base, CUSTOM_MODE[orders.mode], system_status(orders))


def system_status(orders: CommanderState) -> int:
    """As a heartbeat has it."""
    return _TERMINATED if orders.stopped else _ACTIVE if orders.armed else _STANDBY


def _current_mode(mav: Any, now: Moment) -> None:
    orders = now.state.commander
    mav.send_fields(_CURRENT_MODE, CUSTOM_MODE[orders.mode], CUSTOM_MODE[orders.intention], 0)


def _sys_status(mav: Any, now: Moment) -> None:
    ready = PREARM if now.state.has_position else 0
    percent = round(100 * now.sensors.battery_fraction)
    mav.sys_status_send(PREARM, PREARM, ready, 0, int(4000 * _BATTERY_CELL_V), -1, percent, 0, 0, 0, 0, 0, 0)


def accuracy_m(state: AutopilotState) -> float:
    """Of motion capture while there is any, then what dead reckoning makes of it; infinite before the first pose."""
    return _ACCURACY_M + _DRIFT_MPS * state.estimator.since_accepted_s


def _estimator_status(mav: Any, now: Moment) -> None:
    stated_m = accuracy_m(now.state)
    flags = _ESTIMATES if now.state.has_position else 0
    mav.estimator_status_send(now.time_us, flags, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, stated_m, stated_m)


def _battery_status(mav: Any, now: Moment) -> None:
    cells = [int(1000 * _BATTERY_CELL_V)] * 4 + [_NOT_SET] * 6
    mav.battery_status_send(0, 0, 1, 2500, cells, -1, -1, -1, round(100 * now.sensors.battery_fraction))


def _extended_sys_state(mav: Any, now: Moment) -> None:
    mav.extended_sys_state_send(0, _ON_GROUND if now.state.ground.landed else _IN_AIR)


def _attitude_quaternion(mav: Any, now: Moment) -> None:
    q = frames.q_ned_frd_from_enu_flu(now.sensors.q_WB_wxyz).tolist()
    rate = frames.frd_from_flu(now.sensors.omega_B).tolist()
    mav.send_fields(_ATTITUDE_QUATERNION, now.time_us // 1000, *q, *rate, 0.0, 0.0, 0.0, 0.0)


def _actuator_output_status(mav: Any, now: Moment) -> None:
    mav.send_fields(_ACTUATOR_OUTPUT_STATUS, now.time_us, 4, *pwm_us(now.state), *_UNUSED_OUTPUTS)


def has_begun(state: AutopilotState) -> bool:
    """Whether there ever was a position."""
    return math.isfinite(state.estimator.since_accepted_s)


def pwm_us(state: AutopilotState) -> list[int]:
    """Of the four motors: 1000 to 2000, and 900 while disarmed or stopped."""
    if not state.commander.armed or state.commander.stopped:
        return [900] * 4
    return [round(1000.0 + 1000.0 * motor) for motor in state.motors.tolist()]


def _highres_imu(mav: Any, now: Moment) -> None:
    force = frames.frd_from_flu(now.sensors.specific_force_B).tolist()
    rate = frames.frd_from_flu(now.sensors.omega_B).tolist()
    mav.send_fields(_HIGHRES_IMU, now.time_us, *force, *rate, 0, 0, 0, 0, 0, 0, 0, _ACCEPTED_FIELDS, 0)


def _local_position_ned(mav: Any, now: Moment) -> None:
    """Silent before the first pose. After the last one it goes on with what is no longer worth anything, as PX4's does."""
    if has_begun(now.state):
        p = frames.ned_from_enu(now.state.estimate.p_W).tolist()
        v = frames.ned_from_enu(now.state.estimate.v_W).tolist()
        mav.send_fields(_LOCAL_POSITION_NED, now.time_us // 1000, *p, *v)


def _position_target_local_ned(mav: Any, now: Moment) -> None:
    target = now.state.setpoint
    p, v, a = (frames.ned_from_enu(x).tolist() for x in (target.p_W, target.v_W, target.a_W))
    yaw = frames.yaw_ned_from_enu(float(target.yaw_rad))
    mav.position_target_local_ned_send(now.time_us // 1000, 1, 0, *p, *v, *a, yaw, 0.0)


def _attitude_target(mav: Any, now: Moment) -> None:
    """Only its thrust is meant; the attitude is the present one."""
    q = frames.q_ned_frd_from_enu_flu(now.sensors.q_WB_wxyz).tolist()
    mav.attitude_target_send(now.time_us // 1000, 0, q, 0.0, 0.0, 0.0, float(now.state.motors.mean()))


def _timesync(mav: Any, now: Moment) -> None:
    """A question for the companion's time."""
    mav.timesync_send(0, 1000 * now.time_us)


def _autopilot_version(mav: Any, now: Moment) -> None:
    """Capabilities: float parameters, COMMAND_INT, offboard set-points, MAVLink 2."""
    capabilities = 1 << 1 | 1 << 3 | 1 << 6 | 1 << 7 | 1 << 13
    mav.autopilot_version_send(capabilities, VERSION, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 1)


@dataclass
class Stream:
    """One message: how often it goes out (0: only when asked for), at most how often, and when next."""

    message_id: int
    encode: Callable[[Any, Moment], None]
    default_Hz: float
    max_Hz: float
    interval_us: float = 0.0
    due_us: float = 0.0

    def __post_init__(self) -> None:
        self.set_interval(0.0)

    def set_interval(self, interval_us: float) -> None:
        """As MAV_CMD_SET_MESSAGE_INTERVAL has it: 0 is the default, -1 is never."""
        wanted_Hz = self.default_Hz if interval_us == 0.0 else 1e6 / interval_us
        self.interval_us = 1e6 / min(wanted_Hz, self.max_Hz) if wanted_Hz > 0.0 else math.inf
        self.due_us = 0.0 if math.isfinite(self.interval_us) else math.inf

    def schedule(self, time_us: int) -> None:
        """One is sent now: when the next is due. A stream that fell behind does not catch up."""
        self.due_us = max(self.due_us, time_us - self.interval_us) + self.interval_us


def streams() -> tuple[Stream, ...]:
    """All of them. Those that a merged inertial sample is made of come before HIGHRES_IMU, which completes it."""
    return (
        Stream(0, _heartbeat, 1.0, 1.0),
        Stream(_CURRENT_MODE, _current_mode, 0.5, 250.0),
        Stream(1, _sys_status, 1.0, 10.0),
        Stream(147, _battery_status, 0.5, 10.0),
        Stream(230, _estimator_status, 1.0, 50.0),
        Stream(245, _extended_sys_state, 5.0, 50.0),
        Stream(111, _timesync, 10.0, 250.0),
        Stream(148, _autopilot_version, 0.0, 1.0),
        Stream(_ATTITUDE_QUATERNION, _attitude_quaternion, 50.0, 250.0),
        Stream(_ACTUATOR_OUTPUT_STATUS, _actuator_output_status, 10.0, 250.0),
        Stream(83, _attitude_target, 0.0, 125.0),
        Stream(_HIGHRES_IMU, _highres_imu, 50.0, 250.0),
        Stream(_LOCAL_POSITION_NED, _local_position_ned, 30.0, 125.0),
        Stream(85, _position_target_local_ned, 0.0, 125.0),
    )
