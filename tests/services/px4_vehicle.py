"""Real PX4 in software on virtual time: the bridge's Vehicle over its UDP port, pumped by the simulator's step.

PX4 is in lockstep with the physics, so a flight runs as fast as the machine can. What PX4 sends after a step is waited for
before the next, at most `PATIENCE_S` of real time; so its messages arrive within the step they belong to, as over a good
link. MAVSDK has threads and a clock of its own and cannot be here: the messages are the same, pymavlink carries them.
"""

import asyncio
import select
import socket
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import development as dialect

from services.px4_bridge import telecommand, telemetry
from services.px4_bridge.commanded import CommandedVehicle
from services.px4_bridge.telecommand import AUTOPILOT, Fields
from services.px4_bridge.vehicle_protocol import VehicleError
from services.simulator.autopilot import STEP_S, Sensors
from services.simulator.pilot import Pilot
from services.simulator.px4_hil import Px4Hil

Array = NDArray[np.float64]

PATIENCE_S = 0.02
_COMPANION = (1, 191)
_IMU, _ACK = "HIGHRES_IMU", "COMMAND_ACK"


class Px4Vehicle(CommandedVehicle, Pilot):
    """Both ends at once: hand it to `px4_bridge.service.fly` and, as the pilot, to the simulator's stage."""

    def __init__(self, p: telemetry.Vehicle, now_ns: Callable[[], int], hil: Px4Hil, companion_port: int) -> None:
        super().__init__(p, now_ns)
        self._hil = hil
        self._waiting: dict[int, asyncio.Future[int]] = {}
        self._px4: tuple[str, int] | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", companion_port))
        self._socket.setblocking(False)
        self._mav = dialect.MAVLink(self, *_COMPANION)
        self._mav.robust_parsing = True
        self._streaming = False
        self.on_packet: Callable[[str, bytes], None] = lambda _name, _packet: None
        """Is shown every message of the autopilot, by name and as it came."""
        self.mute = False
        """While true no set-point gets through."""

    def close(self) -> None:
        self._socket.close()

    # The simulator's side.

    def motors(self) -> Array:
        if self._hil.starting:
            time.sleep(STEP_S)  # its start is not in lockstep
        motors = self._hil.motors()
        self._pump()
        return motors

    def sense(self, sensors: Sensors) -> None:
        self._hil.sense(sensors)

    def miss(self, seconds: float) -> None:
        self._hil.miss(seconds)

    def _pump(self) -> None:
        """Everything that belongs to the step; inertial samples are complete when HIGHRES_IMU has come."""
        until = time.monotonic() + (PATIENCE_S if self._streaming else 0.0)
        while True:
            while (data := self._read()) is not None:
                for message in self._mav.parse_buffer(data) or ():
                    if self._take(message):
                        until = 0.0
            left = until - time.monotonic()
            if left <= 0.0 or not select.select((self._socket,), (), (), left)[0]:
                break
        if self._telemetry.has_imu:
            self._imu_arrived.set()
        self._told.set()

    def _read(self) -> bytes | None:
        try:
            data, self._px4 = self._socket.recvfrom(65536)
        except BlockingIOError:
            return None
        return data

    def _take(self, message: Any) -> bool:
        """Whether it completes the step."""
        if message.get_srcComponent() != AUTOPILOT or message.get_type() == "BAD_DATA":
            return False
        name, fields = message.get_type(), message.to_dict()
        self.on_packet(name, bytes(message.get_msgbuf()))
        if name == _ACK:
            done = self._waiting.pop(message.command, None)
            if done is not None and not done.done():
                done.set_result(message.result)
        self._telemetry.take(name, fields, self._now_ns())
        return name == _IMU and fields["time_usec"] >= self._hil.time_us

    # The bridge's side.

    async def ready(self) -> None:
        """PX4 is heard and sends at the bridge's rates."""
        async with asyncio.timeout(30.0):
            await self._until(lambda: self._telemetry.heartbeats > 0)
        self.ask_rates()

    def ask_rates(self) -> None:
        """From then on each step has its inertial sample."""
        for name, (number, rate_Hz) in telecommand.RATES_Hz.items():
            if name in self._telemetry.messages:
                self.order(telecommand.command(telecommand.SET_INTERVAL, number, 1e6 / rate_Hz))
        self._streaming = True

    def ask_parameter(self, name: str) -> None:
        """PARAM_VALUE comes back, for `on_packet`."""
        self._send(
            "param_request_read",
            {"target_system": 1, "target_component": AUTOPILOT, "param_id": name.encode(), "param_index": -1},
        )

    def order(self, fields: Fields) -> None:
        """A COMMAND_LONG whose answer nobody waits for."""
        self._send("command_long", fields | {"target_system": 1, "target_component": AUTOPILOT})

    def send_setpoint(self, p_W: Array | None, v_W: Array | None, a_W: Array | None, yaw_rad: float | None) -> None:
        fields = telecommand.setpoint(p_W, v_W, a_W, yaw_rad)
        if self.mute:
            return
        self._send("set_position_target_local_ned", fields | {"target_system": 1, "target_component": AUTOPILOT})

    def send_pose(self, p_W: Array, q_WB_wxyz: Array, stamp_ns: int) -> None:
        fields = telecommand.pose(p_W, q_WB_wxyz, stamp_ns)
        covariance = [np.nan if c is None else c for c in fields["covariance"]]
        self._send("vision_position_estimate", fields | {"covariance": covariance})

    async def set_origin(self) -> None:
        self._send("set_gps_global_origin", telecommand.origin() | {"target_system": 1})

    async def ask_version(self) -> None:
        self.order(telecommand.command(telecommand.REQUEST, telecommand.VERSION))

    async def arming_problems(self) -> list[str]:
        raise VehicleError("arming checks: not asked for on virtual time")

    async def get_parameters(self) -> dict[str, int | float]:
        raise VehicleError("parameters: not asked for on virtual time")

    async def get_parameter(self, name: str) -> int | float:
        raise VehicleError(f"parameter {name}: not asked for on virtual time")

    async def set_parameter(self, name: str, value: int | float) -> None:
        raise VehicleError(f"parameter {name} = {value}: not set on virtual time")

    async def _acknowledged(self, fields: Fields) -> int:
        done = self._waiting[fields["command"]] = asyncio.get_running_loop().create_future()
        self.order(fields)
        return await done

    def _send(self, name: str, fields: Fields) -> None:
        if self._px4 is not None:
            message = getattr(dialect, f"MAVLink_{name}_message")(**fields)
            self._socket.sendto(message.pack(self._mav), self._px4)
