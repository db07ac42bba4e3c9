# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false
"""How old a set-point is when PX4 shows it back: through the bridge's own MAVSDK connection, and through bare pymavlink.

One flight on real PX4 in real time: the world and PX4 in processes of their own, the vehicle in hover, first the bridge's
connection at the companion's port and then a bare socket. Each set-point is marked by a shift of micrometres, by which its
echo (POSITION_TARGET_LOCAL_NED) is known. `python -m benchmarks.px4_age`, with PX4_BIN.
"""

import asyncio
import math
import socket
import sys
import tempfile
import time
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import numpy as np
from mavsdk.plugins.mavlink_direct import MavlinkMessage
from pydantic_core import from_json
from pymavlink.dialects.v20 import development as dialect

from benchmarks.px4_rig import px4
from benchmarks.table import show
from schemas.vehicle import FlightMode
from services.config import Config, load
from services.px4_bridge import telecommand
from services.px4_bridge.vehicle import MavsdkVehicle
from services.px4_bridge.vehicle_protocol import VehicleError
from services.simulator.autopilot import STEP_S
from services.simulator.px4_hil import Px4Hil
from services.simulator.stage import Stage
from services.simulator.world import Told
from tests.services.px4_chain import PX4_BIN

COLUMNS = ("set-point to its echo", "echoes", "p50 ms", "p90 ms", "p99 ms")
RATE_HZ, SECONDS, CLIMB_S, HEIGHT_M = 121.0, 12.0, 8.0, 1.5
"""Not PX4's own 125 Hz: the phase between the two loops, which is a matter of luck, passes through all of its values."""
ECHO_HZ = 125.0
MARKS, MARK_M = 2000, 2e-6
ECHO = "POSITION_TARGET_LOCAL_NED"
_ECHO_ID, _POSE_ID = 85, 102
_POSE_STEPS = 4


def config_of() -> Config:
    """The profile, patient with a stream that changes hands."""
    config = load("px4-sitl", px4=PX4_BIN)
    sitl = config.simulator.px4_sitl
    assert sitl is not None
    patient = replace(sitl, parameters=sitl.parameters | {"COM_OF_LOSS_T": 20.0})
    return config.model_copy(update={"simulator": replace(config.simulator, px4_sitl=patient)})


def world(folder: str, stop: Event) -> None:
    """PX4 and our physics in real time; poses go in by the simulator's port, so that the companion's is free."""
    config = config_of()
    with px4(config, Path(folder)) as hil:
        stage, began, n = Stage(config, lambda _: hil), time.monotonic(), 0
        while not stop.is_set():
            n += 1
            stage.step(Told())
            if n % _POSE_STEPS == 0:
                _show(hil, stage)
            time.sleep(max(0.0, began + n * STEP_S - time.monotonic()))


def _show(hil: Px4Hil, stage: Stage) -> None:
    robot = stage.capture().robot
    pose = telecommand.pose(robot.position_m.array(), robot.q_WB_wxyz.array(), 1000 * hil.time_us)
    numbers = [pose[name] for name in ("x", "y", "z", "roll", "pitch", "yaw")]
    hil.send(_POSE_ID, hil.time_us, *numbers, *[math.nan] * 21, 0)


class Marks:
    """Which set-point was sent when, and how long its echo took."""

    def __init__(self, hover: np.ndarray) -> None:
        self.ages_s: list[float] = []
        self._hover, self._sent_s = hover, [math.nan] * MARKS

    def next(self, n: int) -> np.ndarray:
        """The position of the n-th set-point; its time counts from now."""
        self._sent_s[n % MARKS] = time.perf_counter()
        return self._hover + [MARK_M * (n % MARKS), 0.0, 0.0]

    def echo(self, y_ned_m: float) -> None:
        """PX4's y is our x. Only the first echo of a set-point counts."""
        at = round((y_ned_m - float(self._hover[0])) / MARK_M)
        if 0 <= at < MARKS and not math.isnan(self._sent_s[at]):
            self.ages_s.append(time.perf_counter() - self._sent_s[at])
            self._sent_s[at] = math.nan

    def row(self, name: str) -> tuple[str, ...]:
        ages_ms = 1e3 * np.array(self.ages_s)
        return (name, str(len(ages_ms)), *(f"{np.quantile(ages_ms, q):.1f}" for q in (0.5, 0.9, 0.99)))


async def by_the_bridge(config: Config, hover: np.ndarray) -> Marks:
    """Take off, then measure."""
    link, marks, taken = config.px4_bridge.link, Marks(hover), False

    def on_echo(message: MavlinkMessage, _: Any) -> None:
        if taken:
            marks.echo(from_json(message.fields_json)["y"])

    vehicle_p = config.px4_bridge.vehicle
    async with MavsdkVehicle.connect(link.url, vehicle_p, time.monotonic_ns, link.timeout_s) as vehicle:
        vehicle._direct.subscribe_message(ECHO, on_echo)  # pyright: ignore[reportPrivateUsage]
        flying = asyncio.create_task(_take_off(vehicle))
        began, n, until = time.monotonic(), 0, math.inf
        while time.monotonic() < until:
            n += 1
            vehicle.send_setpoint(marks.next(n), np.zeros(3), np.zeros(3), 0.0)
            if not taken and flying.done():
                flying.result()
                taken, until = True, time.monotonic() + SECONDS
            await asyncio.sleep(max(0.0, began + n / RATE_HZ - time.monotonic()))
    return marks


async def _take_off(vehicle: MavsdkVehicle) -> None:
    """Ask until it is armed in offboard mode; then wait until it hovers and shows its set-points."""
    for _ in range(40):
        await asyncio.sleep(0.5)
        try:
            await vehicle.set_mode(FlightMode.OFFBOARD)
            await vehicle.arm()
            break
        except VehicleError:
            continue
    interval = telecommand.command(telecommand.SET_INTERVAL, _ECHO_ID, 1e6 / ECHO_HZ)
    await vehicle._command("rate of the echo", interval)  # pyright: ignore[reportPrivateUsage]
    await asyncio.sleep(CLIMB_S)


def by_pymavlink(config: Config, hover: np.ndarray) -> Marks:
    """The same set-points and the same echoes on a bare socket, nothing in between."""
    marks, port = Marks(hover), int(config.px4_bridge.link.url.rsplit(":", 1)[1])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bare:
        bare.bind(("127.0.0.1", port))
        _, autopilot = bare.recvfrom(65536)
        mav: Any = dialect.MAVLink(None, 1, 191)
        began = time.monotonic()
        for n in range(1, round(SECONDS * RATE_HZ)):
            fields = telecommand.setpoint(marks.next(n), np.zeros(3), np.zeros(3), 0.0)
            message = dialect.MAVLink_set_position_target_local_ned_message(
                target_system=1, target_component=1, **fields
            )
            bare.sendto(message.pack(mav), autopilot)
            while (left := began + n / RATE_HZ - time.monotonic()) > 0.0:
                bare.settimeout(left)
                try:
                    data = bare.recv(65536)
                except TimeoutError:
                    break
                for heard in mav.parse_buffer(data) or ():
                    if heard.get_type() == ECHO:
                        marks.echo(heard.y)
    return marks


def run() -> list[tuple[str, ...]]:
    """Both, one after the other in one flight."""
    config = config_of()
    start = config.guided_path.p(0.0)
    hover = np.array([start[0], start[1], HEIGHT_M])
    context = get_context("spawn")
    stop = context.Event()
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "logs").mkdir()
        flying = context.Process(target=world, args=(folder, stop))
        flying.start()
        try:
            bridge = asyncio.run(by_the_bridge(config, hover))
            bare = by_pymavlink(config, hover)
        finally:
            stop.set()
            flying.join(10.0)
    return [bridge.row("bridge (MAVSDK)"), bare.row("bare pymavlink")]


if __name__ == "__main__":
    if not PX4_BIN:
        print("px4_age: skipped: PX4_BIN is not set")
        sys.exit(0)
    show(run(), COLUMNS)
