"""What real PX4 does when the bridge is killed: its set-points end, and its poses with them."""

import asyncio
from typing import NamedTuple

import numpy as np

from schemas.safety import Phase
from schemas.topics import TRUTH
from schemas.vehicle import FlightMode
from services.config import Config
from services.rehearsal import px4_flight
from services.rehearsal.chain import Flight, Stage

PATIENCE_S, DOWN_M = 30.0, 0.1


class Fall(NamedTuple):
    """Seconds from the bridge's death: offboard left, on the ground, disarmed; infinite where it is not seen to come."""

    left_s: float
    down_s: float
    disarmed_s: float
    pull_N: float
    """The cable's on the hand, at most, later than 1.5 s."""


def without_bridge(config: Config, phase: Phase) -> Fall:
    """The bridge dies 2 s into `phase`."""
    killed_s, left_s, disarmed_s = 0.0, np.inf, np.inf

    async def script(stage: Stage) -> None:
        nonlocal killed_s, left_s, disarmed_s
        await px4_flight.started(stage)
        await stage.until(lambda state: state.phase is phase, 90.0)
        await asyncio.sleep(2.0)
        stage.kill("px4_bridge")
        killed_s = stage.now_s
        while (since_s := stage.now_s - killed_s) < PATIENCE_S:
            robot = stage.flight.vehicle.sample
            if robot.mode is not FlightMode.OFFBOARD:
                left_s = min(left_s, since_s)
            if not robot.armed:
                disarmed_s = since_s
                break
            await asyncio.sleep(0.05)

    return _fall(px4_flight.fly(config, script), killed_s, left_s, disarmed_s)


def _fall(flight: Flight, killed_s: float, left_s: float, disarmed_s: float) -> Fall:
    after = [m for m in flight.said[TRUTH.key] if m.stamp_ns * 1e-9 > killed_s]
    since_s = np.array([m.stamp_ns * 1e-9 for m in after]) - killed_s
    above = since_s[[m.robot_position_m.z > DOWN_M for m in after]]
    down_s = float(above[-1]) if len(above) and above[-1] < since_s[-1] else np.inf
    pull_N = max(float(np.linalg.norm(m.hand_force_N.array())) for m in after if m.stamp_ns * 1e-9 > killed_s + 1.5)
    return Fall(left_s, down_s, disarmed_s, pull_N)
