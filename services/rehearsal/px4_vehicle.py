"""Real PX4 in software on virtual time: the bridge's Vehicle over its UDP port, pumped by the simulator's step.

PX4 is in lockstep with the physics, so a flight runs as fast as the machine can. What PX4 sends after a step is waited for
before the next, at most `PATIENCE_S` of real time; so its messages arrive within the step they belong to, as over a good
link. MAVSDK has threads and a clock of its own and cannot be here: the messages are the same, pymavlink carries them.
"""

import asyncio
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.px4_bridge import telecommand, telemetry
from services.px4_bridge.telecommand import Fields
from services.px4_bridge.vehicle_protocol import VehicleError
from services.rehearsal.ground_station import GroundStation
from services.rehearsal.mavlink_peer import MavlinkPeer
from services.rehearsal.rehearsed_vehicle import RehearsedVehicle
from services.simulator.autopilot import STEP_S, Sensors
from services.simulator.commander import Arm, KillSwitch, Request, SetParameter
from services.simulator.pilot import Pilot
from services.simulator.px4_hil import Px4Hil
from services.simulator.radio_control import RadioControl

Array = NDArray[np.float64]

PATIENCE_S = 0.02
DRAINED_S = 0.01
_COMPANION = 191
_IMU, _ACK, _VALUE = "HIGHRES_IMU", "COMMAND_ACK", "PARAM_VALUE"


class Px4Vehicle(RehearsedVehicle, Pilot):
    """Both ends at once: hand it to `px4_bridge.service.fly` and, as the pilot, to the simulator's stage."""

    def __init__(
        self,
        p: telemetry.Vehicle,
        now_ns: Callable[[], int],
        hil: Px4Hil,
        companion_port: int,
        station: GroundStation | None = None,
        system: int = 1,
    ) -> None:
        super().__init__(p, now_ns)
        self._hil, self._station = hil, station
        self._waiting: dict[int, asyncio.Future[int]] = {}
        self._peer = MavlinkPeer(
            (system, _COMPANION),
            {*self._telemetry.messages, *telecommand.RATES_Hz, _ACK, _VALUE},
            vehicle=system,
            port=companion_port,
        )
        self._streaming = False
        self.on_packet: Callable[[str, bytes], None] = lambda _name, _packet: None
        """Is shown every message that is listened to, by name and as it came."""

    def close(self) -> None:
        self._peer.close()

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
            for message in self._peer.messages():
                if self._take(message):
                    until = 0.0
            if not self._peer.wait(until - time.monotonic()):
                break
        self._arrive(self._wake)
        for mode, armed in self._station.modes() if self._station else ():
            self._is_in(mode, armed)

    def _take(self, message: Any) -> bool:
        """Whether it completes the step."""
        name, fields = message.get_type(), message.to_dict()
        self.on_packet(name, bytes(message.get_msgbuf()))
        if not self.cut:
            self._arrive(partial(self._hear, name, fields))
        return name == _IMU and fields["time_usec"] >= self._hil.time_us

    def _hear(self, name: str, fields: Fields) -> None:
        if name == _ACK:
            done = self._waiting.pop(fields["command"], None)
            if done is not None and not done.done():
                done.set_result(fields["result"])
        self._heard(self.garble([(name, fields)]))

    # What is done to it.

    @property
    def radio_control(self) -> RadioControl:
        """The pilot's."""
        assert self._hil.radio_control, "the pilot has none: simulator.px4_sitl.radio_control"
        return self._hil.radio_control

    def pilot(self, asked: Request) -> None:
        if isinstance(asked, KillSwitch):
            self.radio_control.kill = asked.on
            return
        assert self._station, "nobody sits at a ground station"
        self._station.ask(asked)

    def refuse(self, kind: type[Request]) -> None:
        if kind is not Arm:
            raise ValueError(f"PX4 cannot be made to refuse {kind.__name__}")
        self.pilot(SetParameter("COM_ARMABLE", 0))

    def drain(self, percent: int) -> None:
        self.pilot(SetParameter("SIM_BAT_MIN_PCT", float(percent)))
        self.pilot(SetParameter("SIM_BAT_DRAIN", DRAINED_S))

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
        self._send("param_request_read", self._peer.target | {"param_id": name.encode(), "param_index": -1})

    def order(self, fields: Fields) -> None:
        """A COMMAND_LONG whose answer nobody waits for."""
        if not self.cut:
            self._peer.command(fields)

    def send_setpoint(self, p_W: Array | None, v_W: Array | None, a_W: Array | None, yaw_rad: float | None) -> None:
        fields = telecommand.setpoint(p_W, v_W, a_W, yaw_rad)
        self.sent_ns.append(self._now_ns())
        if not self.mute:
            self._send("set_position_target_local_ned", fields | self._peer.target)

    def send_pose(self, p_W: Array, q_WB_wxyz: Array, stamp_ns: int) -> None:
        fields = telecommand.pose(p_W, q_WB_wxyz, stamp_ns)
        covariance = [np.nan if c is None else c for c in fields["covariance"]]
        self._send("vision_position_estimate", fields | {"covariance": covariance})

    async def set_origin(self) -> None:
        if not self.cut:
            self._peer.place()

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
        if not self.cut:
            self._peer.send(name, fields)
