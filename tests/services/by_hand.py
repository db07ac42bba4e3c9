"""Vehicle and handle in a person's hands, motors off, before a real capture system: what calibration asks for.

The whole system runs on virtual time. The capture system reports marker bodies to the code that takes a vendor's frames:
the handle's markers stand off from O_H, and everything arrives `late_s` after it was true, which nobody is told.
"""

import asyncio
from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np

from schemas.topics import MOCAP_SEEN
from schemas.tracking import MocapFrame
from services.config import Config
from services.physics import Array, integrate_attitude, rotate
from services.px4_bridge import service as bridge
from services.rehearsal.chain import ON_THE_BUS_ONLY, Flight, _recording, perform
from services.rehearsal.direct_vehicle import DirectVehicle
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node
from services.runtime.virtual import VirtualClock, run_virtual
from services.simulator import imu
from services.simulator.autopilot import STEP_S
from services.simulator.pilot import StandIn
from services.simulator.stage import Stage
from services.simulator.world import Told
from services.tracker import service as tracker
from services.tracker.capture import Capture
from services.tracker.sources import Source

O_H, CARRIED = np.array([-2.0, -0.9, 0.9]), np.array([-2.0, -0.5, 1.0])
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
FRAME_STEPS = 4  # 62.5 Hz
PACES_RAD_S = np.array([1.9, 2.6, 1.3])


class InHands(Stage):
    """The simulated world and its sensors, but both bodies are turned by a person, to all sides and back."""

    def __init__(self, config: Config, offset_m: Array, late_s: float, vehicle: DirectVehicle) -> None:
        super().__init__(config, lambda robot: StandIn(config.simulator.autopilot, robot, vehicle))
        self._offset_m, self._steps = offset_m, 0
        self._shown = deque([(LEVEL, LEVEL)], maxlen=1 + round(late_s / STEP_S))
        """Attitudes of vehicle and handle, the newest last; the first is what the capture system tells now."""

    def step(self, told: Told) -> None:
        """As Stage.step, with hands in the place of physics."""
        self._steps += 1
        robot_q, handle_q = self._shown[-1]
        rate = 0.6 * PACES_RAD_S * np.cos(PACES_RAD_S * self._steps * STEP_S)
        self._shown.append((_turned(robot_q, rate), _turned(handle_q, rate[::-1])))
        robot = self.world.robot._replace(p_W=CARRIED, v_W=np.zeros(3), q_WB_wxyz=self._shown[-1][0], omega_B=rate)
        self.world = self.world._replace(robot=robot)
        self._pilot.sense(self._sensed(robot.v_W))

    @property
    def frame_due(self) -> bool:
        """At the capture system's rate."""
        return self._steps % FRAME_STEPS == 0

    def poses(self) -> dict[str, list[float]]:
        """Of both marker bodies by their names there, with its noise."""
        system, p = self.config.tracker.mocap, self.config.simulator.mocap
        assert system is not None
        robot_q, handle_q = self._shown[0]
        true = {system.robot.body: (CARRIED, robot_q)}
        true[system.handle.body] = (O_H - rotate(handle_q, self._offset_m), handle_q)
        noisy = {name: imu.mocap(*pose, self._noise.standard_normal(6), p) for name, pose in true.items()}
        return {name: [*position.tolist(), *q.tolist()] for name, (position, q) in noisy.items()}


def _turned(q: Array, rate: Array) -> Array:
    return integrate_attitude(q, rate, STEP_S)


def held(config: Config, offset_m: Array, late_s: float, seconds: float, record: Path) -> Flight:
    """What was said meanwhile, also in a recording. `offset_m` is O_H in the frame of the handle's markers."""
    system = config.tracker.mocap
    assert system is not None

    async def flight() -> Flight:
        clock, bus = VirtualClock(), MemoryBus()
        vehicle = DirectVehicle(config.px4_bridge.vehicle, clock.now_ns)
        stage, capture = InHands(config, offset_m, late_s, vehicle), Capture(config.tracker.source, system, clock)
        takers: list[Callable[[MocapFrame], None]] = []

        async def turning(node: Node) -> None:
            async for tick in node.ticks(1.0 / STEP_S):
                stage.step(Told())
                if stage.frame_due and takers:
                    capture._heard({"arrived_ns": tick.stamp_ns, "poses": stage.poses()}, takers[0])

        async def tracking(node: Node) -> None:
            arrivals = node.arrivals()
            takers.append(arrivals.put)
            await tracker.track(node, config, Source(arrivals, MOCAP_SEEN))

        runs = {
            "recorder": _recording(config, record),
            "simulator": turning,
            "tracker": tracking,
            "px4_bridge": lambda node: bridge.fly(node, config, vehicle),
        }
        others = [name for name in ON_THE_BUS_ONLY if name not in runs]
        return await perform(config, lambda _: asyncio.sleep(seconds), bus, clock, vehicle, runs, others)

    return run_virtual(flight(), limit_s=seconds + 60.0)
