"""From set-points, poses and orders in world ENU to the fields of the autopilot's messages; pure.

The counterpart of telemetry.py. A component that is not set goes out as 0 with its bit in the type mask, because JSON
has no NaN; where MAVLink wants one, `None` is the way to it.
"""

import math
from collections.abc import Iterable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from schemas import frames
from schemas.vehicle import FlightMode

Array = NDArray[np.float64]
Fields: TypeAlias = dict[str, Any]

AUTOPILOT = 1
TOLD_ENOUGH = 600  # answers to TIMESYNC: PX4 believes us after 500, and leaves out those that took long
FORCED = 21196.0  # MAVLink's second parameter of a disarming that asks no questions
SET_MODE, TERMINATE, ARM, SET_INTERVAL, REQUEST = 176, 185, 400, 511, 512
VERSION = 148
MODE_NUMBERS = {FlightMode.OFFBOARD: (6, 0), FlightMode.HOLD: (4, 3), FlightMode.LAND: (4, 6)}
RESULTS = {1: "temporarily rejected", 2: "denied", 3: "unsupported", 4: "failed", 6: "cancelled"}
RATES_Hz = {  # message: number and rate, of which the ones that are listened to are asked for
    "ATTITUDE_QUATERNION": (31, 250.0),
    "LOCAL_POSITION_NED": (32, 50.0),
    "ATTITUDE_TARGET": (83, 125.0),
    "HIGHRES_IMU": (105, 250.0),
    "BATTERY_STATUS": (147, 1.0),
    "ESTIMATOR_STATUS": (230, 1.0),
    "EXTENDED_SYS_STATE": (245, 10.0),
    "ESC_STATUS": (291, 250.0),
    "ACTUATOR_OUTPUT_STATUS": (375, 250.0),
    "CURRENT_MODE": (436, 50.0),
    "TIMESYNC": (111, 100.0),  # 6 s until it knows
}
DISPENSABLE = ("CURRENT_MODE", "ESTIMATOR_STATUS")
"""PX4 before 1.15 has no CURRENT_MODE, and tells the mode by its heartbeat of 1 Hz alone; the other is for preflight."""
_CUSTOM_MODE, _LOCAL_NED = 1, 1
_COMPONENTS = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz")  # in the order of the mask's bits
_UNSET = np.full(3, np.nan)
_IGNORE_YAW, _IGNORE_YAW_RATE = 1 << 10, 1 << 11


def setpoint(p_W: Array | None, v_W: Array | None, a_W: Array | None, yaw_rad: float | None) -> Fields:
    """SET_POSITION_TARGET_LOCAL_NED. Raises ValueError on an infinite component."""
    values = _ned(_UNSET if v is None else v for v in (p_W, v_W, a_W))
    fields: Fields = {"coordinate_frame": _LOCAL_NED, "yaw_rate": 0.0, "time_boot_ms": 0}
    mask = _IGNORE_YAW_RATE
    for bit, (name, value) in enumerate(zip(_COMPONENTS, values, strict=True)):
        unset = math.isnan(value)
        fields[name] = 0.0 if unset else value
        mask |= unset << bit
    if yaw_rad is None or math.isnan(yaw_rad):
        return fields | {"yaw": 0.0, "type_mask": mask | _IGNORE_YAW}
    return fields | {"yaw": frames.yaw_ned_from_enu(yaw_rad), "type_mask": mask}


def pose(p_W: Array, q_WB_wxyz: Array, stamp_ns: int) -> Fields:
    """VISION_POSITION_ESTIMATE with an unknown covariance."""
    x, y, z = _ned([p_W])
    roll, pitch, yaw = euler_ned_frd(q_WB_wxyz)
    covariance = [None] + [0.0] * 20
    where: Fields = {"usec": stamp_ns // 1000, "x": x, "y": y, "z": z, "covariance": covariance, "reset_counter": 0}
    return where | {"roll": roll, "pitch": pitch, "yaw": yaw}


def our_time(asked: Fields, now_ns: int) -> Fields:
    """TIMESYNC, in answer to the autopilot's: so it knows when a pose was taken, by its stamp on this host's clock."""
    return {"tc1": now_ns, "ts1": asked["ts1"]}


def origin() -> Fields:
    """SET_GPS_GLOBAL_ORIGIN: some place on earth."""
    return {"latitude": 473_977_419, "longitude": 85_455_938, "altitude": 0, "time_usec": 0}


def command(number: int, *parameters: float) -> Fields:
    """COMMAND_LONG; parameters that are not given are 0."""
    values = (*parameters, *[0.0] * (7 - len(parameters)))
    return {"command": number, "confirmation": 0} | {f"param{i}": value for i, value in enumerate(values, start=1)}


def mode(wanted: FlightMode) -> Fields:
    """The command for a mode. Raises ValueError for one that cannot be asked for."""
    if wanted not in MODE_NUMBERS:
        raise ValueError(f"mode: {wanted.value} cannot be asked for; possible are {', '.join(MODE_NUMBERS)}")
    return command(SET_MODE, _CUSTOM_MODE, *MODE_NUMBERS[wanted])


def euler_ned_frd(q_WB_wxyz: Array) -> tuple[float, float, float]:
    """Roll, pitch, yaw in rad of the body in the autopilot's frames, as MAVLink's pose message has them."""
    w, x, y, z = frames.q_ned_frd_from_enu_flu(q_WB_wxyz).tolist()
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(min(max(2 * (w * y - z * x), -1.0), 1.0))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw


def _ned(vectors_W: Iterable[Array]) -> list[float]:
    """The components of all of them, one after the other."""
    values: list[float] = frames.ned_from_enu(np.array(list(vectors_W))).ravel().tolist()
    if any(map(math.isinf, values)):
        raise ValueError(f"set-point: {values} (NED) must be finite")
    return values
