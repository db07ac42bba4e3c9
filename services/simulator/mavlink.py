# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
"""The stand-in autopilot's end of a MAVLink 2 connection over UDP; the only place that plays a vehicle on the wire.

No thread and no clock of its own: the simulator's loop calls `receive` before and `send` after each step of the
autopilot, and the time in the messages is the vehicle's. The dialect is imported by its MAVLink 2 name, so that no
environment variable decides about the version.
"""

import math
import socket
import struct
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import development as dialect

from schemas import frames
from services.simulator import mavlink_orders
from services.simulator.autopilot import STEP_S, AutopilotState, Input, Output, Pose, Sensors, Target
from services.simulator.cascade import Setpoint
from services.simulator.commander import Ack, SetOrigin, SetParameter
from services.simulator.mavlink_streams import Moment, streams
from services.simulator.timesync import Timesync
from services.simulator.wire import Wire

Array = NDArray[np.float64]

_SYSTEM, _AUTOPILOT = 1, 1
_DATAGRAM_BYTES = 1400
_LOCAL_NED = 1
_FORCE_SETPOINT, _IGNORE_YAW = 1 << 9, 1 << 10
_INT32, _REAL32 = 6, 9
_WARNING = 4


class MavlinkLink:
    """A vehicle that talks to a companion at `remote`, from `local_port` (0: any free one).

    Raises OSError when `local_port` is taken.
    """

    def __init__(self, remote: tuple[str, int] = ("127.0.0.1", 14540), local_port: int = 0) -> None:
        self.remote = remote
        self.sent: dict[int, int] = {}
        """How many of each stream have gone out, by message id."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind(("", local_port))
        self._mav = Wire(self, _SYSTEM, _AUTOPILOT)
        self._mav.robust_parsing = True
        self._datagram = bytearray()
        self._streams = streams()
        self._asked: set[int] = set()
        self._replies: list[Callable[[Any, AutopilotState], None]] = []
        self._inputs: list[Input] = []
        self._now_us = 0
        self._timesync = Timesync()
        self._handlers = self._understood()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _type: type[BaseException] | None, _e: BaseException | None, _t: TracebackType | None) -> None:
        self._socket.close()

    def receive(self) -> list[Input]:
        """What has arrived since the last call, oldest first. Never blocks; damaged bytes are skipped."""
        while (data := self._read()) is not None:
            for message in self._mav.parse_buffer(data) or ():
                handler = self._handlers.get(message.get_msgId())
                if handler is not None and _is_for_us(message):
                    handler(message)
        inputs, self._inputs = self._inputs, []
        return inputs

    def send(self, state: AutopilotState, sensors: Sensors, output: Output) -> None:
        """Send answers, remarks and every stream that is due at the vehicle's time."""
        now = Moment(state, sensors, round(state.t_s * 1e6))
        self._now_us = now.time_us
        soon_us = now.time_us + 0.5e6 * STEP_S
        for stream in self._streams:
            is_due = stream.due_us <= soon_us
            if is_due:
                stream.schedule(now.time_us)
            if is_due or stream.message_id in self._asked:
                stream.encode(self._mav, now)
                self.sent[stream.message_id] = self.sent.get(stream.message_id, 0) + 1
        self._asked.clear()
        self._answer(state, output)
        self._flush()

    def write(self, packet: bytes) -> None:
        """Where the dialect puts a packed message: into the datagram that goes out next."""
        if len(self._datagram) + len(packet) > _DATAGRAM_BYTES:
            self._flush()
        self._datagram += packet

    def _flush(self) -> None:
        if not self._datagram:
            return
        with suppress(BlockingIOError, ConnectionRefusedError):  # a radio does not wait for its listener either
            self._socket.sendto(self._datagram, self.remote)
        self._datagram.clear()

    def _read(self) -> bytes | None:
        try:
            return self._socket.recv(65536)
        except (BlockingIOError, ConnectionRefusedError):
            return None

    def _answer(self, state: AutopilotState, output: Output) -> None:
        for request, ack in output.answers:
            if isinstance(request, SetParameter):
                self._send_parameter(state, request.name)
            elif request.ticket:
                self._mav.command_ack_send(request.ticket, int(ack))
        for reply in self._replies:
            reply(self._mav, state)
        self._replies.clear()
        for text in output.texts:
            self._mav.statustext_send(_WARNING, text.encode()[:50])

    def _send_parameter(self, state: AutopilotState, name: str) -> None:
        """Silent about an unknown name, as PX4 is. Integers travel as their bits."""
        if name not in state.px4:
            return
        value, names = state.px4[name], list(state.px4)
        number = _float_of_bits(value) if isinstance(value, int) else value
        kind = _INT32 if isinstance(value, int) else _REAL32
        self._mav.param_value_send(name.encode(), number, kind, len(names), names.index(name))

    def _understood(self) -> dict[int, Callable[[Any], None]]:
        return {
            dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._on_setpoint,
            dialect.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE: self._on_pose,
            dialect.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN: self._on_origin,
            dialect.MAVLINK_MSG_ID_COMMAND_LONG: self._on_command,
            dialect.MAVLINK_MSG_ID_COMMAND_INT: self._on_command,
            dialect.MAVLINK_MSG_ID_PARAM_SET: self._on_parameter_set,
            dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._on_parameter_read,
            dialect.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._on_parameter_list,
            dialect.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: self._on_mission_list,
            dialect.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
        }

    def _on_setpoint(self, message: Any) -> None:
        if message.coordinate_frame != _LOCAL_NED or message.type_mask & _FORCE_SETPOINT:
            return
        mask = message.type_mask
        sent = (message.x, message.y, message.z, message.vx, message.vy, message.vz)
        sent += (message.afx, message.afy, message.afz)
        kept = [math.nan if mask >> bit & 1 else value for bit, value in enumerate(sent)]
        p, v, a = frames.enu_from_ned(np.array(kept).reshape(3, 3))
        yaw = math.nan if mask & _IGNORE_YAW else frames.yaw_ned_from_enu(message.yaw)
        self._inputs.append(Target(Setpoint(p, v, a, yaw)))

    def _on_pose(self, message: Any) -> None:
        age_s = self._timesync.age_s(message.usec, self._now_us)
        self._inputs.append(Pose(frames.enu_from_ned(np.array((message.x, message.y, message.z))), age_s))

    def _on_origin(self, _message: Any) -> None:
        self._inputs.append(SetOrigin())

    def _on_command(self, message: Any) -> None:
        command, first, second = message.command, message.param1, message.param2
        asked = mavlink_orders.request(command, first, second, message.param3)
        if asked is None:
            self._reply(command, self._on_message_command(command, mavlink_orders.whole(first), second))
        else:
            self._inputs.append(asked)

    def _on_message_command(self, command: int, message_id: int, interval_us: float) -> Ack:
        """Requests about messages, which the autopilot itself does not hear of."""
        if command == dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
            message_id = dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
        elif command not in (dialect.MAV_CMD_REQUEST_MESSAGE, dialect.MAV_CMD_SET_MESSAGE_INTERVAL):
            return Ack.UNSUPPORTED
        stream = next((stream for stream in self._streams if stream.message_id == message_id), None)
        if stream is None:
            return Ack.DENIED
        if command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
            if message_id == dialect.MAVLINK_MSG_ID_HEARTBEAT:
                return Ack.FAILED  # PX4 keeps that one at 1 Hz
            stream.set_interval(interval_us)
        else:
            self._asked.add(message_id)
        return Ack.ACCEPTED

    def _reply(self, command: int, ack: Ack) -> None:
        self._replies.append(lambda mav, _state: mav.command_ack_send(command, int(ack)))

    def _on_parameter_set(self, message: Any) -> None:
        is_integer = message.param_type != _REAL32
        value = _bits_of_float(message.param_value) if is_integer else message.param_value
        self._inputs.append(SetParameter(message.param_id, value))

    def _on_parameter_read(self, message: Any) -> None:
        def reply(_mav: Any, state: AutopilotState) -> None:
            names = list(state.px4)
            by_index = 0 <= message.param_index < len(names)
            self._send_parameter(state, names[message.param_index] if by_index else message.param_id)

        self._replies.append(reply)

    def _on_parameter_list(self, _message: Any) -> None:
        def reply(_mav: Any, state: AutopilotState) -> None:
            for name in state.px4:
                self._send_parameter(state, name)

        self._replies.append(reply)

    def _on_mission_list(self, message: Any) -> None:
        """There is no mission."""
        sender, component = message.get_srcSystem(), message.get_srcComponent()
        self._replies.append(lambda mav, _state: mav.mission_count_send(sender, component, 0, message.mission_type))

    def _on_timesync(self, message: Any) -> None:
        asked_ns = message.ts1
        if message.tc1 == 0:
            self._replies.append(lambda mav, state: mav.timesync_send(round(state.t_s * 1e9), asked_ns))
        else:
            self._timesync.take(self._now_us, message.tc1 * 1e-3, asked_ns * 1e-3)


def _is_for_us(message: Any) -> bool:
    return getattr(message, "target_system", 0) in (0, _SYSTEM)


def _float_of_bits(value: int) -> float:
    return struct.unpack("<f", struct.pack("<i", value))[0]


def _bits_of_float(value: float) -> int:
    return struct.unpack("<i", struct.pack("<f", value))[0]
