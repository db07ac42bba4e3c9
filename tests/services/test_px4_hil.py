"""The lockstep with a PX4 that the test plays at the other end of the connection."""

import math
import socket
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as dialect

from services.physics import GRAVITY_MPS2
from services.simulator.autopilot import Sensors
from services.simulator.px4_hil import Px4Hil, Px4Lost
from services.simulator.radio_control import PARAMETERS, RadioControl
from services.simulator.wire import Wire, take_frame, unpack

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
AT_REST = Sensors(np.array([0.1, 0.2, GRAVITY_MPS2]), np.array([0.01, 0.02, 0.03]), LEVEL, height_m=2.0)
ARMED, DISARMED = 129, 1


class Px4:
    """The far end: what it was sent, and what it answers."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.mav = dialect.MAVLink(None, 1, 1)

    def heard(self):
        self.connection.setblocking(False)
        try:
            return self.mav.parse_buffer(self.connection.recv(65536)) or []
        except BlockingIOError:
            return []
        finally:
            self.connection.setblocking(True)

    def answer(self, time_us, motors, mode=ARMED):
        controls = [*motors, *[0.0] * (16 - len(motors))]
        message = dialect.MAVLink_hil_actuator_controls_message(time_us, controls, mode, 1)
        self.connection.sendall(message.pack(self.mav))

    def says_something_else(self):
        self.connection.sendall(dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3).pack(self.mav))


@pytest.fixture
def ends():
    server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    server.bind(("127.0.0.1", 0))
    server.listen(1)
    far = socket.create_connection(server.getsockname())
    near, _ = server.accept()
    with server, far, near:
        yield Px4Hil(near), Px4(far)


def test_sensors_go_out_in_px4s_axes_with_a_clock_of_4_ms(ends):
    hil, px4 = ends
    for _ in range(5):
        hil.sense(AT_REST)
    sent = [m for m in px4.heard() if m.get_type() == "HIL_SENSOR"]
    assert [m.time_usec for m in sent] == [4000, 8000, 12000, 16000, 20000]
    assert [m.id for m in sent] == [0] * 5
    first, fifth = sent[0], sent[4]
    assert (first.xacc, first.yacc, first.zacc) == pytest.approx((0.1, -0.2, -GRAVITY_MPS2), rel=1e-6)
    assert (first.xgyro, first.ygyro, first.zgyro) == pytest.approx((0.01, -0.02, -0.03), rel=1e-6)
    assert first.fields_updated == 0b111111  # no air, and never a magnetometer
    assert fifth.fields_updated & 0b1000000000
    assert not fifth.fields_updated & 0b111000000
    assert fifth.abs_pressure == pytest.approx(1013.25 * math.exp(-2.0 / 8434.5), rel=1e-6)


def test_a_pilots_radio_control_speaks_at_50_Hz_with_its_switch_where_px4_is_told(ends):
    (hil, px4), heard = ends, []
    hil.radio_control = RadioControl()
    for step in range(50):
        hil.radio_control.kill = step >= 25
        hil.sense(AT_REST)
        heard += [m for m in px4.heard() if m.get_type() == "RC_CHANNELS"]
    assert [m.time_boot_ms for m in heard] == list(range(20, 201, 20))
    assert {m.chancount for m in heard} == {PARAMETERS["RC_CHAN_CNT"]}
    sticks = ("RC_MAP_ROLL", "RC_MAP_PITCH", "RC_MAP_THROTTLE", "RC_MAP_YAW")
    assert {getattr(m, f"chan{PARAMETERS[stick]}_raw") for m in heard for stick in sticks} == {1500}
    switch = [getattr(m, f"chan{PARAMETERS['RC_MAP_KILL_SW']}_raw") for m in heard]
    assert switch == [1000] * 5 + [2000] * 5


def test_without_a_pilot_nothing_is_heard_of_one(ends):
    hil, px4 = ends
    for _ in range(10):
        hil.sense(AT_REST)
    assert {m.get_type() for m in px4.heard()} == {"HIL_SENSOR"}


def test_while_px4_starts_nobody_waits_for_it(ends):
    hil, px4 = ends
    px4.says_something_else()
    for _ in range(3):
        assert np.array_equal(hil.motors(), np.zeros(4))
        hil.sense(AT_REST)
    assert hil.starting


def test_the_world_waits_for_the_answer_to_its_newest_sample(ends):
    hil, px4 = ends
    hil.sense(AT_REST)
    px4.answer(4000, [0.1, 0.2, 0.3, 0.4])
    assert hil.motors() == pytest.approx([0.1, 0.2, 0.3, 0.4], rel=1e-6)
    assert not hil.starting
    hil.sense(AT_REST)
    px4.answer(4000, [0.9] * 4)  # late, to the sample before
    px4.says_something_else()
    px4.answer(8000, [0.5] * 4)
    assert hil.motors() == pytest.approx([0.5] * 4)


def test_motors_stand_still_while_it_is_not_armed(ends):
    hil, px4 = ends
    hil.sense(AT_REST)
    px4.answer(4000, [0.5] * 4, mode=DISARMED)
    assert np.array_equal(hil.motors(), np.zeros(4))


def test_a_px4_that_ends_or_hangs_is_told_in_words(ends, monkeypatch):
    hil, px4 = ends
    hil.sense(AT_REST)
    px4.answer(4000, [0.5] * 4)
    hil.motors()
    hil.sense(AT_REST)
    hil._socket.settimeout(0.05)
    with pytest.raises(Px4Lost, match="not answered"):
        hil.motors()
    px4.connection.close()
    with pytest.raises(Px4Lost, match=r"ended|gone"):
        hil.motors()


@given(
    cuts=st.lists(st.integers(1, 60), max_size=12),
    motors=st.lists(st.floats(0.0, 1.0, width=32), min_size=4, max_size=4),
)
def test_a_stream_may_be_cut_anywhere(cuts, motors):
    """TCP delivers bytes, not messages; trailing zeros do not travel."""
    mav = dialect.MAVLink(None, 1, 1)
    controls = [*motors, *[0.0] * 12]
    packets = [dialect.MAVLink_hil_actuator_controls_message(n, controls, 129, 1).pack(mav) for n in (1, 2, 3)]
    whole, stream, found = b"".join(packets), bytearray(), []
    edges = sorted({min(sum(cuts[: i + 1]), len(whole)) for i in range(len(cuts))} | {len(whole)})
    for begin, end in zip([0, *edges], edges, strict=False):
        stream += whole[begin:end]
        while (frame := take_frame(stream)) is not None:
            found.append(unpack(*frame))
    assert [fields[0] for fields in found] == [1, 2, 3]
    assert all(fields[2:6] == tuple(motors) and fields[18] == 129 for fields in found)
    assert not stream


def test_what_is_not_mavlink_2_is_refused():
    with pytest.raises(ValueError, match="not MAVLink 2"):
        take_frame(bytearray(b"GET / HTTP/1.1\r\n"))


def test_the_quick_packer_and_pymavlink_agree():
    sent = []

    class File:
        write = staticmethod(sent.append)

    fields = (4000, *[float(n) for n in range(1, 14)], 63, 0)
    Wire(File, 1, 1).send_fields(107, *fields)
    parser: Any = dialect.MAVLink(None, 1, 1)
    (message,) = parser.parse_buffer(sent[0])
    assert (message.time_usec, message.xacc, message.temperature, message.fields_updated) == (4000, 1.0, 13.0, 63)
    assert struct.calcsize(dialect.mavlink_map[107].unpacker.format) == 65


def test_a_world_that_stood_still_is_a_gap_in_px4s_clock(ends):
    hil, px4 = ends
    hil.sense(AT_REST)
    hil.miss(0.3)
    hil.sense(AT_REST)
    assert [m.time_usec for m in px4.heard() if m.get_type() == "HIL_SENSOR"] == [4000, 308000]
