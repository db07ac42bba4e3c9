"""From the messages of a recording, or of a living system, to what the calibration laws take.

Everything is by topic: a table of columns (recorder/table.py) with `t_s`, s on one clock.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from schemas.message import Message
from schemas.safety import Phase
from schemas.topics import MOCAP_FRAME, MOCAP_SEEN, ROBOT_POSE, SAFETY_STATE, VEHICLE_IMU, VEHICLE_STATE, Topic
from schemas.vehicle import ThrustSource
from services.calibration.fit import Unfit
from services.calibration.thrust import Flight
from services.physics import rotate
from services.recorder.table import Array, Table

MOCAP = (MOCAP_FRAME, MOCAP_SEEN)
"""Where frames of motion capture are: simulated ones, or those of a real system. Only one of them is ever heard."""

TOPICS: Mapping[str, tuple[Topic[Message], ...]] = {
    "thrust": (VEHICLE_IMU, VEHICLE_STATE, SAFETY_STATE),
    "mass": (VEHICLE_IMU, VEHICLE_STATE, SAFETY_STATE),
    "handle": MOCAP,
    "delay": (VEHICLE_IMU, ROBOT_POSE),
}
"""What each calibration listens to."""

UNHELD = (Phase.IDLE, Phase.TAKEOFF, Phase.ZEROING, Phase.CLEARING)
"""Phases in which nobody has a hand on the handle; in a flight by remote control it stays idle."""
LIFTED_M = 0.15
_NONE: Table = {"t_s": np.zeros(0)}

Tables = Mapping[str, Table]


class Motors(NamedTuple):
    """Which quantity the shares are of, and the thrust that the bridge made of them, (N,) N."""

    source: ThrustSource
    thrust_N: Array


def flight(tables: Tables, rest_length_m: float) -> Flight:
    """Inertial samples; those are used in which it flies so high that what is on the cable hangs, and nobody holds it.

    Raises Unfit where there are none, or where they do not say what the motors did.
    """
    imu, state = tables[VEHICLE_IMU.key], _heard(tables, VEHICLE_STATE.key)
    t_s = _heard(tables, VEHICLE_IMU.key)["t_s"]
    if not np.any(imu["throttle_mean"] > 0.0):
        raise Unfit("vehicle/imu has no throttle: the recording is older than it, or the motors never turned")
    at = _last(state["t_s"], t_s)
    high = state["position_m"][:, 2] > rest_length_m + LIFTED_M
    use = (state["valid"] & state["armed"] & state["in_air"] & high)[at] & _unheld(tables, t_s)
    x, y = imu["q_WB_wxyz"][:, 1], imu["q_WB_wxyz"][:, 2]
    return Flight(
        dt_s=float(np.median(np.diff(t_s))),
        a_z=imu["specific_force_B_mps2"][:, 2],
        upright=1.0 - 2.0 * (x * x + y * y),
        mean=imu["throttle_mean"],
        square=imu["throttle_square_mean"],
        battery_V=state["battery_V"][at],
        use=use,
    )


def motors(tables: Tables) -> Motors:
    """What the bridge made of them."""
    imu = tables[VEHICLE_IMU.key]
    return Motors(ThrustSource(imu["thrust_source"][-1]), imu["thrust_N"])


def handle_poses(tables: Tables, offset_m: Sequence[float]) -> tuple[Array, Array, Array]:
    """Stamps (N,) and poses (N, 3), (N, 4) of the handle's markers while they are seen. Raises Unfit.

    Frames tell where O_H was believed to be: that belief, `offset_m` in the markers' frame (3,), is taken out again.
    """
    key = next((topic.key for topic in MOCAP if len(tables.get(topic.key, _NONE)["t_s"])), MOCAP_FRAME.key)
    frames = _heard(tables, key)
    seen = frames["handle.tracked"]
    q = frames["handle.q_WB_wxyz"][seen]
    p = frames["handle.position_m"][seen] - rotate(q, np.broadcast_to(offset_m, (len(q), 3)))
    return frames["t_s"][seen], p, q


def attitudes(tables: Tables) -> tuple[Array, Array, Array, Array]:
    """Stamps (N,) and attitudes (N, 4) by motion capture; stamps (M,) and body rates (M, 3). Raises Unfit."""
    poses, imu = _heard(tables, ROBOT_POSE.key), _heard(tables, VEHICLE_IMU.key)
    return poses["t_s"], poses["q_WB_wxyz"], imu["t_s"], imu["angular_rate_B_rad_s"]


def _unheld(tables: Tables, t_s: Array) -> Array:
    """Without a supervisor nobody is on the cable."""
    safety = tables.get(SAFETY_STATE.key)
    if safety is None or not len(safety["t_s"]):
        return np.ones(len(t_s), dtype=bool)
    free = np.isin(safety["phase"].astype(str), [phase.value for phase in UNHELD]) & ~safety["held"]
    return free[_last(safety["t_s"], t_s)]


def _heard(tables: Tables, key: str) -> Table:
    if key not in tables or len(tables[key]["t_s"]) < 2:
        raise Unfit(f"nothing was heard on {key}")
    return tables[key]


def _last(t_s: Array, at: Array) -> Array:
    """Which of `t_s` (N,) is the last one at the times `at` (M,); the first before it."""
    return np.maximum(np.searchsorted(t_s, at, side="right") - 1, 0)
