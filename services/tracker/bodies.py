"""From what a capture system reports, by its own names, to frames of robot and handle.

A capture system reports poses of bodies as they were defined there: origin and axes are a matter of how somebody put
markers on and pressed a button. The profile names the two bodies and says where on them the vehicle's centre of mass and
O_H are. Three things are put right here: bodies that come one by one are gathered to frames, a pose that is repeated bit
for bit is not a measurement (a server holds the last pose of a hidden body, or hangs), and the marker's offset is taken
out.

| here | unit | frame |
|---|---|---|
| Pose: position, attitude w first | m, - | W; capture body to W |
| Body.offset_m | m | the capture body's |
"""

import math
from collections.abc import Mapping
from dataclasses import field
from typing import NamedTuple, TypeAlias

import numpy as np

from services.parameters import Positive, parameters
from services.physics import Array, rotate

SIMULATED = "simulated"
LIBRARY: dict[str, str] = {
    "vicon": "motioncapture",
    "optitrack": "motioncapture",
    "qualisys": "motioncapture",
    "vrpn": "motioncapture",
    "mock": "motioncapture",
    "qtm": "qtm_rt",
}
"""The capture systems that can be chosen, by the package that speaks with them."""
GATHER_S = 0.015
"""How long a body that came alone waits for the other, from a server that sends bodies one by one (VRPN)."""
_NORM_TOLERANCE = 0.01

Pose: TypeAlias = tuple[float, float, float, float, float, float, float]


@parameters
class Body:
    """A rigid body of the capture system, and the point of it that counts."""

    body: str
    """Its name there."""
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """From its origin to the vehicle's centre of mass, or to O_H, along its own axes."""


@parameters
class CaptureSystem:
    """A real capture system."""

    host: str
    """Name or address of its server; for VRPN also host:port."""
    robot: Body
    handle: Body
    rate_min_Hz: Positive
    rate_max_Hz: Positive
    repeat_s: Positive
    """A pose that has not changed by a bit for this long is none."""
    restart_s: Positive
    """After this silence the connection is made anew."""
    settings: dict[str, str] = field(default_factory=dict[str, str])
    """More for the package that speaks with it, by its own names: port, interface_ip, port_command."""


class Seen(NamedTuple):
    """Bodies at one moment, those that are tracked."""

    stamp_ns: int
    poses: Mapping[str, Pose]


def check(source: str, p: CaptureSystem | None) -> None:
    """Whether a source can be opened.

    Raises:
        ValueError: key, value and limit.
    """
    if source == SIMULATED:
        return
    if source not in LIBRARY:
        raise ValueError(f"tracker.source = {source!r}: must be one of {', '.join([SIMULATED, *LIBRARY])}")
    if p is None:
        raise ValueError(f"tracker.mocap: is missing, for tracker.source = {source!r}")
    if p.robot.body == p.handle.body:
        raise ValueError(f"tracker.mocap.handle.body = {p.handle.body!r}: is the robot's too, must be another body")
    if p.rate_max_Hz <= p.rate_min_Hz:
        raise ValueError(f"tracker.mocap.rate_max_Hz = {p.rate_max_Hz}: must be above rate_min_Hz = {p.rate_min_Hz}")


def usable(pose: Pose) -> bool:
    """Finite, and with an attitude: what a driver says of a body that it does not see often is neither."""
    return all(map(math.isfinite, pose)) and abs(math.hypot(*pose[3:]) - 1.0) < _NORM_TOLERANCE


def gather(waiting: Seen, now: Seen, wanted: frozenset[str]) -> tuple[Seen, list[Seen]]:
    """Frames from bodies that come one by one: complete ones at once, others when their time is up or a body comes again.

    `waiting` is what has not been said yet. A frame is as old as its oldest body.
    """
    new = {name: pose for name, pose in now.poses.items() if name in wanted}
    if wanted <= new.keys():
        return Seen(0, {}), [Seen(now.stamp_ns, new)]
    said: list[Seen] = []
    if waiting.poses.keys() & new.keys():
        said, waiting = [waiting], Seen(0, {})
    if new:
        waiting = Seen(waiting.stamp_ns if waiting.poses else now.stamp_ns, {**waiting.poses, **new})
    overdue = bool(waiting.poses) and now.stamp_ns - waiting.stamp_ns >= GATHER_S * 1e9
    if overdue or wanted <= waiting.poses.keys():
        said, waiting = [*said, waiting], Seen(0, {})
    return waiting, said


Repeats: TypeAlias = Mapping[str, tuple[Pose, int]]
"""Of each body the last pose, and since when it has been that."""


def unrepeated(last: Repeats, now: Seen, repeat_s: float) -> tuple[Repeats, Seen]:
    """Without the bodies whose pose has stood still to the last bit for `repeat_s`: no measurement does that."""
    since = {
        name: last[name] if name in last and last[name][0] == pose else (pose, now.stamp_ns)
        for name, pose in now.poses.items()
    }
    moving = {name: pose for name, pose in now.poses.items() if now.stamp_ns - since[name][1] < repeat_s * 1e9}
    return {**last, **since}, Seen(now.stamp_ns, moving)


def placed(pose: Pose, body: Body) -> tuple[Array, Array]:
    """Position in m of the point that counts, (3,), and the attitude as a unit quaternion, w first, (4,)."""
    q = np.array(pose[3:]) / math.hypot(*pose[3:])
    return np.array(pose[:3]) + rotate(q, np.array(body.offset_m)), q
