"""What preflight looks at beside the vehicle: the capture system, for a few seconds, and the clocks of two hosts."""

import asyncio
import time
from collections.abc import Sequence

import numpy as np

from schemas.radio import RadioClock
from schemas.topics import GATEWAYS, RADIO_CLOCK
from schemas.tracking import MocapFrame, RigidBody
from services.config import Config
from services.px4_bridge.preflight import Reason
from services.runtime.node import Node
from services.safety_supervisor.rules import Limits
from services.tracker import preflight
from services.tracker.bodies import SIMULATED
from services.tracker.capture import Capture

APPEARS_S, LOOKS_S = 8.0, 4.0
_CLOCKS_S = 4.0


async def look_at_capture(config: Config, looks_s: float = LOOKS_S, appears_s: float = APPEARS_S) -> list[Reason]:
    """The list for a real capture system; empty for a simulated one."""
    p = config.tracker
    if p.mocap is None or p.source == SIMULATED:
        return []
    capture, arrived = Capture(p.source, p.mocap), list[tuple[int, MocapFrame]]()
    task = asyncio.create_task(capture.follow(lambda frame: arrived.append((time.monotonic_ns(), frame))))
    try:
        for _ in range(round(appears_s / 0.1)):
            if arrived:
                break
            await asyncio.sleep(0.1)
        await asyncio.sleep(looks_s if arrived else 0.0)
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    return [Reason(*each) for each in preflight.reasons(_frames(arrived, capture.trouble), p.mocap, p.axes)]


def _frames(arrived: Sequence[tuple[int, MocapFrame]], trouble: str) -> preflight.Frames:
    stamps_ns = np.array([frame.stamp_ns for _, frame in arrived], dtype=np.int64)
    arrivals_ns = np.array([at_ns for at_ns, _ in arrived], dtype=np.int64)
    bodies = [(frame.robot, frame.handle) for _, frame in arrived]
    return preflight.Frames(
        lasted_s=float(stamps_ns[-1] - stamps_ns[0]) * 1e-9 if len(stamps_ns) else 0.0,
        stamp_s=np.asarray((stamps_ns - stamps_ns[:1]) * 1e-9, dtype=np.float64),
        late_s=np.asarray((arrivals_ns - stamps_ns) * 1e-9, dtype=np.float64),
        robot=np.array([robot.tracked for robot, _ in bodies], dtype=bool),
        handle=np.array([handle.tracked for _, handle in bodies], dtype=bool),
        position_m=np.array([[_xyz(robot), _xyz(handle)] for robot, handle in bodies]).reshape(-1, 2, 3),
        q_WB_wxyz=np.array([robot.q_WB_wxyz.array() for robot, _ in bodies]).reshape(-1, 4),
        trouble=trouble,
    )


def _xyz(body: RigidBody) -> tuple[float, float, float]:
    return body.position_m.x, body.position_m.y, body.position_m.z


async def look_at_clocks(config: Config, node: Node) -> list[Reason]:
    """The list for a host of two, whose gateways may run meanwhile; empty for a system on one."""
    if config.system.host not in GATEWAYS:
        return []
    clock = node.latest(RADIO_CLOCK)
    for _ in range(round(_CLOCKS_S / 0.1)):
        await asyncio.sleep(0.1)
        if clock.value is not None:
            break
    return clock_reasons(clock.value, config.safety_supervisor.limits)


def clock_reasons(clock: RadioClock | None, p: Limits) -> list[Reason]:
    """What the supervisor would not start with."""
    if clock is None:
        cure = "clew run gateway on both hosts, then clew link"
        return [Reason("the clocks of the two hosts are not compared", cure)]
    listed: list[Reason] = []
    if clock.uncertainty_s > p.clock_uncertainty_max_s:
        known = f"the hosts' clocks are known to {1000 * clock.uncertainty_s:.0f} ms"
        listed.append(
            Reason(f"{known}, at most {1000 * p.clock_uncertainty_max_s:.0f} ms to begin", "a better radio: clew link")
        )
    if abs(clock.time_of_day_apart_s) > p.time_of_day_apart_max_s:
        apart = f"the hosts differ by {abs(clock.time_of_day_apart_s):.1f} s in the time of day"
        listed.append(Reason(apart, "set up chrony: deploy/chrony"))
    return listed
