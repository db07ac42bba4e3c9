# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# ruff: noqa: D102  (docstrings are the protocol's)
"""The vehicle behind a MAVLink connection; the only code that talks to an autopilot, through MAVSDK.

Everything goes through MAVSDK's `mavlink_direct`: nothing there repeats a set-point, and motors and inertial sensors
can be had at full rate. Its callbacks run in one thread of MAVSDK's; they only stamp and hand over to the event loop,
for a plugin call in there would never return.
"""

import asyncio
import logging
from collections import deque
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any, cast

import mavsdk
import numpy as np
from mavsdk import ComponentType, Configuration, ConnectionResult, LogLevel, Mavsdk
from mavsdk.plugins.events import Events, EventsError
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkDirectResult, MavlinkMessage
from mavsdk.plugins.param import Param, ParamError, ParamResult
from numpy.typing import NDArray
from pydantic_core import from_json, to_json

from services.px4_bridge import telecommand, telemetry
from services.px4_bridge.commanded import CommandedVehicle
from services.px4_bridge.port import refuse_used
from services.px4_bridge.telecommand import AUTOPILOT, Fields
from services.px4_bridge.telemetry import VehicleSample
from services.px4_bridge.vehicle_protocol import LINK_CURE, VehicleError

Array = NDArray[np.float64]

_TIMESYNC, _WARNING = "TIMESYNC", 4  # the latter by syslog's levels
_ALL_PARAMETERS_S = 60.0  # a thousand of them, over a slow link
_log = logging.getLogger(__name__)


class MavsdkVehicle(CommandedVehicle):
    """A Vehicle by MAVSDK; made by `connect`."""

    def __init__(
        self, system: Any, p: telemetry.Vehicle, now_ns: Callable[[], int], answer_s: float, *, tell_time: bool
    ) -> None:
        super().__init__(p, now_ns, answer_s)
        self._loop = asyncio.get_running_loop()
        self._inbox: deque[tuple[str, str, int]] = deque()
        self._handing_over = False
        self._renewal: asyncio.Task[None] | None = None
        self._system, self._events = system, cast(Events | None, None)
        self._system_id: int = system.get_system_id()
        self._direct, self._parameters = MavlinkDirect(system), Param(system)
        self._tell_time, self._time_told = tell_time, 0
        self._wanted = (*self._telemetry.messages, *([_TIMESYNC] if tell_time else []))
        for name in self._wanted:
            self._direct.subscribe_message(name, self._on_message)

    @classmethod
    @asynccontextmanager
    async def connect(
        cls,
        url: str,
        p: telemetry.Vehicle,
        now_ns: Callable[[], int],
        timeout_s: float = 10.0,
        answer_s: float = 3.0,
        *,
        tell_time: bool = False,
    ) -> AsyncGenerator["MavsdkVehicle", None]:
        """Connected to the autopilot behind `url`: udpin://host:port, serial:///dev/name:baud or tcpout://host:port.

        Waits `timeout_s` for the autopilot and `answer_s` for each of its answers; stamps come from `now_ns`. With
        `tell_time` the autopilot is told this clock, so that it dates poses by their stamps and not by their arrival.
        Raises VehicleError when the port is in use, the URL is no good or no autopilot appears.
        """
        refuse_used(url)
        mavsdk.log_subscribe(_on_log)
        library = Mavsdk(Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER))
        try:
            result = library.add_any_connection(url)
            if result is not ConnectionResult.SUCCESS:
                raise VehicleError(f"cannot open {url}: {result.name.lower().replace('_', ' ')}")
            system = await _first_autopilot(library, url, timeout_s)
            vehicle = cls(system, p, now_ns, answer_s, tell_time=tell_time)
            await vehicle._request_rates()
            yield vehicle
        finally:
            library.destroy()
            mavsdk.log_unsubscribe()

    @property
    def sample(self) -> VehicleSample:
        knows_time = not self._tell_time or self._time_told >= telecommand.TOLD_ENOUGH
        return super().sample._replace(knows_time=knows_time)

    def send_setpoint(self, p_W: Array | None, v_W: Array | None, a_W: Array | None, yaw_rad: float | None) -> None:
        fields = telecommand.setpoint(p_W, v_W, a_W, yaw_rad)
        self._send("SET_POSITION_TARGET_LOCAL_NED", self._addressed(fields))

    def send_pose(self, p_W: Array, q_WB_wxyz: Array, stamp_ns: int) -> None:
        self._send("VISION_POSITION_ESTIMATE", telecommand.pose(p_W, q_WB_wxyz, stamp_ns))

    async def set_origin(self) -> None:
        self._send("SET_GPS_GLOBAL_ORIGIN", telecommand.origin() | {"target_system": self._system_id})

    async def ask_version(self) -> None:
        await self._command("version", telecommand.command(telecommand.REQUEST, telecommand.VERSION))

    async def arming_problems(self) -> list[str]:
        self._events = self._events or Events(self._system)  # not before: its dictionary is fetched from the vehicle
        try:
            report = await self._in_thread("arming checks", self._events.get_health_and_arming_checks_report)
        except EventsError as error:
            raise VehicleError(f"arming checks: {error.result.name.lower()}") from None
        mode = report.current_mode_intention
        grave = [p.message for p in mode.problems if p.log_level <= _WARNING]
        return [] if mode.can_arm_or_run else grave or [f"cannot arm in mode {mode.mode_name}"]

    async def get_parameters(self) -> dict[str, int | float]:
        found = await self._in_thread("parameters", self._parameters.get_all_params, within_s=_ALL_PARAMETERS_S)
        return {each.name: each.value for each in (*found.int_params, *found.float_params)}

    async def get_parameter(self, name: str) -> int | float:
        try:
            return await self._in_thread(f"parameter {name}", self._parameters.get_param_int, name)
        except ParamError as error:
            if error.result is not ParamResult.WRONG_TYPE:
                raise VehicleError(f"parameter {name}: {error.result.name.lower()}") from error
        return await self._in_thread(f"parameter {name}", self._parameters.get_param_float, name)

    async def set_parameter(self, name: str, value: int | float) -> None:
        setter = self._parameters.set_param_int if isinstance(value, int) else self._parameters.set_param_float
        try:
            await self._in_thread(f"parameter {name}", setter, name, value)
        except ParamError as error:
            raise VehicleError(f"parameter {name} = {value}: {error.result.name.lower()}") from error

    async def _in_thread(self, what: str, call: Callable[..., Any], *arguments: Any, within_s: float = 0.0) -> Any:
        """A blocking call, which MAVSDK itself ends within a few seconds, so that the process can still exit."""
        within_s = within_s or self._answer_s
        try:
            async with asyncio.timeout(within_s):
                return await asyncio.to_thread(call, *arguments)
        except TimeoutError:
            raise VehicleError(f"{what}: no answer within {within_s:g} s") from None

    async def _acknowledged(self, fields: Fields) -> int:
        done: asyncio.Future[int] = self._loop.create_future()
        self._direct.send_command_async(_message("COMMAND_LONG", self._addressed(fields)), self._on_answer, done)
        return await done

    async def _request_rates(self) -> None:
        for name, (number, rate_Hz) in telecommand.RATES_Hz.items():
            if name in self._wanted:
                interval = telecommand.command(telecommand.SET_INTERVAL, number, 1e6 / rate_Hz)
                try:
                    await self._command(f"rate of {name}", interval)
                except VehicleError as error:
                    if name not in telecommand.DISPENSABLE:
                        raise
                    _log.warning("%s", error)

    async def _renew_rates(self) -> None:
        """After a silence, for an autopilot that has started anew has forgotten them."""
        try:
            await self._request_rates()
        except VehicleError as error:
            _log.warning("%s", error)

    def _addressed(self, fields: Fields) -> Fields:
        return fields | {"target_system": self._system_id, "target_component": AUTOPILOT}

    def _send(self, name: str, fields: Fields) -> None:
        self._direct.send_message(_message(name, fields))

    # In MAVSDK's thread: stamp and hand over, nothing else.

    def _on_message(self, message: MavlinkMessage, _user_data: Any) -> None:
        if message.component_id != AUTOPILOT:
            return
        self._inbox.append((message.message_name, message.fields_json, self._now_ns()))
        if not self._handing_over:  # one wake-up for all that arrives together
            self._handing_over = True
            self._loop.call_soon_threadsafe(self._take_inbox)

    def _on_answer(self, result: MavlinkDirectResult, answer: MavlinkMessage, done: asyncio.Future[int]) -> None:
        code = from_json(answer.fields_json)["result"] if result is MavlinkDirectResult.SUCCESS else -1
        self._loop.call_soon_threadsafe(_settle, done, code)

    # In the event loop.

    def _take_inbox(self) -> None:
        self._handing_over = False
        heartbeats, was_connected = self._telemetry.heartbeats, self._telemetry.connected(self._now_ns())
        statuses = self._telemetry.statuses
        while self._inbox:
            name, text, arrival_ns = self._inbox.popleft()
            fields = from_json(text, cache_strings="keys")
            if name == _TIMESYNC:
                self._answer_time(fields, arrival_ns)
            self._telemetry.take(name, fields, arrival_ns)
        if self._telemetry.has_imu:
            self._imu_arrived.set()
        if self._telemetry.statuses > statuses:
            self._told.set()
        if self._telemetry.heartbeats > heartbeats > 0 and not was_connected:
            self._renewal = asyncio.create_task(self._renew_rates())

    def _answer_time(self, asked: Fields, arrival_ns: int) -> None:
        if not asked["tc1"]:
            self._time_told += 1
            self._send(_TIMESYNC, telecommand.our_time(asked, arrival_ns))


def _message(name: str, fields: Fields) -> MavlinkMessage:
    return MavlinkMessage(message_name=name, fields_json=to_json(fields).decode())


def _settle(done: asyncio.Future[Any], result: Any) -> None:
    if not done.done():
        done.set_result(result)


async def _first_autopilot(library: Mavsdk, url: str, timeout_s: float) -> Any:
    loop = asyncio.get_running_loop()
    found: asyncio.Future[Any] = loop.create_future()

    def on_found(system: Any) -> None:
        loop.call_soon_threadsafe(_settle, found, system)

    waiting = library.first_autopilot_async(timeout_s, on_found)
    try:
        system = await found
    finally:
        library.cancel_first_autopilot(waiting)
    if system is None:
        raise VehicleError(f"no autopilot on {url} within {timeout_s:g} s: {LINK_CURE}")
    return system


def _on_log(level: LogLevel, message: str, _file: str | None, _line: int) -> bool:
    """MAVSDK's remarks go the way of all others."""
    _log.log(10 * (int(level) + 1), "%s", message)
    return True
