"""The bridge's link to PX4 on virtual time, and the ground station beside it, with an autopilot that the test plays over UDP."""

import asyncio
import socket
import struct
from contextlib import closing
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import development as dialect

from schemas.vehicle import FlightMode
from services.config import load
from services.rehearsal.ground_station import ASK_STEPS, GroundStation
from services.rehearsal.px4_vehicle import Px4Vehicle
from services.rehearsal.rehearsed_vehicle import UNREAD_S
from services.runtime.virtual import VirtualClock, run_virtual
from services.simulator.commander import Arm, Mode, SetParameter, Switch, Terminate
from services.simulator.wire import frames

HOLD, OFFBOARD = 4 << 16 | 3 << 24, 6 << 16
ARMED, DISARMED = 129, 1


class Px4:
    """Its end of one link."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(1.0)
        self.port = self.socket.getsockname()[1]
        self.near = 0  # the port that it talks to
        self.mav = dialect.MAVLink(None, 1, 1)

    def says(self, to: int, *messages: dialect.MAVLink_message, component: int = 1) -> None:
        self.mav.srcComponent = component
        self.socket.sendto(b"".join(message.pack(self.mav) for message in messages), ("127.0.0.1", to))

    def hears(self):
        """The next message, and where it came from."""
        data, sender = self.socket.recvfrom(65536)
        message = next(iter(self.mav.parse_buffer(data) or ()))
        return message, sender[1]

    def is_silent_to(self) -> bool:
        self.socket.setblocking(False)
        try:
            return not self.socket.recv(65536)
        except BlockingIOError:
            return True
        finally:
            self.socket.settimeout(1.0)

    def close(self) -> None:
        self.socket.close()


def beat(mode: int, base_mode: int) -> dialect.MAVLink_message:
    return dialect.MAVLink_heartbeat_message(2, 12, base_mode, mode, 4, 3)


@pytest.fixture
def px4():
    with closing(Px4()) as far:
        yield far


@pytest.fixture
def station(px4):
    with closing(GroundStation(px4.port)) as near:
        yield near


def test_a_datagram_is_taken_apart_and_what_is_no_message_is_left():
    mav = dialect.MAVLink(None, 1, 1)
    packets = [beat(HOLD, ARMED).pack(mav), dialect.MAVLink_timesync_message(1, 2).pack(mav)]
    found = list(frames(b"".join(packets) + b"\xfe\x01\x02"))
    assert [(number, component) for number, component, _ in found] == [(0, 1), (111, 1)]
    assert [frame for _, _, frame in found] == packets


def test_the_station_asks_for_beats_and_tells_mode_and_arming(px4, station):
    for _ in range(ASK_STEPS + 1):
        assert not list(station.modes())
    asked, port = px4.hears()
    assert (asked.command, asked.param1, asked.get_srcSystem()) == (512, 0.0, 255)
    px4.hears()
    assert px4.is_silent_to(), "asked in each step"
    px4.says(port, beat(HOLD, ARMED), dialect.MAVLink_timesync_message(1, 2), beat(OFFBOARD, DISARMED))
    px4.says(port, beat(HOLD, DISARMED), component=100)  # some camera's
    assert list(station.modes()) == [(FlightMode.HOLD, True), (FlightMode.OFFBOARD, False)]


def test_what_a_pilot_asks_for_at_the_station(px4, station):
    station.ask(Switch(Mode.LAND))
    land, _ = px4.hears()
    assert (land.command, land.param1, land.param2, land.param3) == (176, 1.0, 4.0, 6.0)
    station.ask(Arm(False, force=True))
    off, _ = px4.hears()
    assert (off.command, off.param1, off.param2) == (400, 0.0, 21196.0)
    station.ask(SetParameter("COM_OBL_RC_ACT", 5))
    whole, _ = px4.hears()
    assert (whole.param_id, whole.param_type) == ("COM_OBL_RC_ACT", 6)
    assert struct.unpack("<i", struct.pack("<f", whole.param_value)) == (5,)
    station.ask(SetParameter("SIM_BAT_MIN_PCT", 10.0))
    real, _ = px4.hears()
    assert (real.param_type, real.param_value) == (9, 10.0)
    with pytest.raises(ValueError, match="no pilot asks for that"):
        station.ask(Terminate())


def fly(px4: Px4, script) -> None:
    """`script(vehicle, step)` on virtual time; a step of the simulator takes what has come."""

    async def flight() -> None:
        hil: Any = SimpleNamespace(starting=False, time_us=0, motors=lambda: np.zeros(4))
        vehicle = Px4Vehicle(load("demo").px4_bridge.vehicle, VirtualClock().now_ns, hil, 0)
        with closing(vehicle):
            px4.near = vehicle._peer._socket.getsockname()[1]
            px4.says(px4.near, beat(OFFBOARD, ARMED))
            vehicle.motors()
            await script(vehicle)

    run_virtual(flight())


def test_a_cut_link_passes_nothing_either_way(px4):
    async def script(vehicle: Px4Vehicle) -> None:
        assert vehicle.sample.mode is FlightMode.OFFBOARD
        vehicle.cut = True
        px4.says(px4.near, beat(HOLD, ARMED))
        vehicle.motors()
        vehicle.send_setpoint(np.zeros(3), None, None, 0.0)
        vehicle.send_pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), 0)
        vehicle.order({"command": 400})
        assert vehicle.sample.mode is FlightMode.OFFBOARD
        assert len(vehicle.sent_ns) == 1, "the bridge believes to have sent it"
        assert px4.is_silent_to()
        vehicle.cut, vehicle.mute = False, True
        vehicle.send_setpoint(np.zeros(3), None, None, 0.0)
        assert px4.is_silent_to()
        vehicle.send_pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), 0)
        assert px4.hears()[0].get_type() == "VISION_POSITION_ESTIMATE"

    fly(px4, script)


def test_what_comes_while_the_process_stands_still_is_read_later(px4):
    async def script(vehicle: Px4Vehicle) -> None:
        vehicle.stop()
        px4.says(px4.near, beat(HOLD, ARMED))
        vehicle.motors()
        assert vehicle.sample.mode is FlightMode.OFFBOARD
        vehicle.go_on()
        assert vehicle.sample.mode is FlightMode.OFFBOARD
        await asyncio.sleep(2 * UNREAD_S)
        assert vehicle.sample.mode is FlightMode.HOLD

    fly(px4, script)


def test_messages_can_be_bent_on_their_way(px4):
    async def script(vehicle: Px4Vehicle) -> None:
        vehicle.garble = lambda messages: [(name, {**fields, "custom_mode": HOLD}) for name, fields in messages]
        px4.says(px4.near, beat(OFFBOARD, ARMED))
        vehicle.motors()
        assert vehicle.sample.mode is FlightMode.HOLD

    fly(px4, script)
