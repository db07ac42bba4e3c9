"""A stand-in autopilot that somebody plays over UDP, and real MAVSDK at the other end."""

import asyncio
import threading
import time
from collections.abc import AsyncGenerator, Callable, Generator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import replace

import numpy as np

from services.config import load
from services.px4_bridge.vehicle import MavsdkVehicle
from services.simulator.autopilot import STEP_S, Input, Target
from services.simulator.cascade import Setpoint
from services.simulator.mavlink import MavlinkLink
from tests.laws.standin import ABOVE, Standin

PATIENCE_S = 20.0
VEHICLE = replace(load("demo").px4_bridge.vehicle, connection_timeout_s=0.5)


class Played:
    """A stand-in that flies in real time in a thread of its own, and remembers what it was sent."""

    def __init__(self, port: int) -> None:
        self.drone = Standin()
        self.drone.mocap_offset_W = None
        self.url = f"udpin://127.0.0.1:{port}"
        self.link = MavlinkLink(("127.0.0.1", port))
        self.link._streams[0].set_interval(100_000)  # heartbeats at 10 Hz, to be found soon
        self.received: list[Input] = []
        self.silent = False
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run)

    @property
    def setpoints(self) -> list[Setpoint]:
        return [item.setpoint for item in self.received if isinstance(item, Target)]

    def _run(self) -> None:
        due = time.monotonic()
        while not self._ends.is_set():
            inputs = self.link.receive()
            self.received += inputs
            output = self.drone.step(inputs)
            if not self.silent:
                self.link.send(self.drone.state, self.drone.sensors, output)
            due = max(due + STEP_S, time.monotonic() - 0.1)
            time.sleep(max(0.0, due - time.monotonic()))

    @contextmanager
    def playing(self) -> Generator["Played", None, None]:
        with self.link:
            self._thread.start()
            try:
                yield self
            finally:
                self._ends.set()
                self._thread.join()


@asynccontextmanager
async def connected(played: Played) -> AsyncGenerator[MavsdkVehicle, None]:
    async with MavsdkVehicle.connect(played.url, VEHICLE, time.monotonic_ns, PATIENCE_S, PATIENCE_S) as vehicle:
        yield vehicle


async def wait_for(is_so: Callable[[], bool]) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not is_so():  # noqa: ASYNC110
            await asyncio.sleep(0.01)


async def feed(vehicle: MavsdkVehicle, played: Played, *, fly: bool) -> None:
    """Poses from the truth, and set-points, at 100 Hz until cancelled."""
    while True:
        robot = played.drone.robot
        vehicle.send_pose(robot.p_W, robot.q_WB_wxyz, time.monotonic_ns())
        if fly:
            vehicle.send_setpoint(ABOVE, np.zeros(3), np.zeros(3), 0.0)
        await asyncio.sleep(0.01)


@asynccontextmanager
async def fed(vehicle: MavsdkVehicle, played: Played, *, fly: bool) -> AsyncGenerator[None, None]:
    task = asyncio.create_task(feed(vehicle, played, fly=fly))
    try:
        yield
    finally:
        task.cancel()
