"""Our physics as PX4's simulator: its sensors go out, its motors come back, in lockstep over TCP.

PX4 is the client and has no clock of its own: the time in each HIL_SENSOR is its time, and it answers each one with
HIL_ACTUATOR_CONTROLS. So the world waits for the motors of the newest sample before it goes on, and the flight is the same
however fast it runs. Sensors go out as soon as they are known and the answer is waited for at the next step: between two
steps PX4 has the time to itself.
"""

import math
import select
import socket

import numpy as np

from schemas import frames
from services.physics import Array
from services.runtime.plain import PlainError
from services.simulator.autopilot import STEP_S, Sensors
from services.simulator.pilot import Pilot
from services.simulator.radio_control import PERIOD_STEPS, RC_CHANNELS, RadioControl
from services.simulator.wire import Wire, take_frame, unpack

ANSWER_S = 2.0
"""PX4 answers within a millisecond; after this it is lost."""

_SENSOR, _MOTORS = 107, 93
_SYSTEM, _COMPONENT = 1, 1
_INERTIAL, _BAROMETER = 0b111111, 0b1101000000000
_BAROMETER_STEPS = 5  # 50 Hz
_ARMED = 128
_STEP_us = round(1e6 * STEP_S)
_SEA_LEVEL_hPa, _SCALE_HEIGHT_M, _ROOM_degC = 1013.25, 8434.5, 20.0


class Px4Lost(PlainError):
    """PX4 has gone, or does not answer."""


class Px4Hil(Pilot):
    """The pilot at the other end of an accepted connection."""

    def __init__(self, connection: socket.socket, radio_control: RadioControl | None = None) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.settimeout(ANSWER_S)
        self._socket = connection
        self._wire = Wire(self, _SYSTEM, _COMPONENT)
        self._stream = bytearray()
        self._motors = np.zeros(4)
        self.radio_control = radio_control
        """Of a pilot, who may move it at any time; None: there is none."""
        self.time_us = 0
        self.armed = False
        self._answered_us = -1
        """The sample that was answered last."""

    @property
    def starting(self) -> bool:
        """PX4 has not answered yet: until it does the lockstep does not hold, and it takes its own time."""
        return self._answered_us < 0

    def motors(self) -> Array:
        """Wait for the answer to the newest sample. While PX4 starts it does not answer: then the motors stand still.

        Raises Px4Lost.
        """
        lockstep = not self.starting
        while self._answered_us < self.time_us and self._receive(wait=lockstep):
            pass
        return self._motors

    def sense(self, sensors: Sensors) -> None:
        """Send HIL_SENSOR, which moves PX4's clock on, and what a radio control says. Raises Px4Lost."""
        self.time_us += _STEP_us
        self._pilot()
        barometer = self.time_us // _STEP_us % _BAROMETER_STEPS == 0
        force = frames.frd_from_flu(sensors.specific_force_B).tolist()
        rate = frames.frd_from_flu(sensors.omega_B).tolist()
        air = (_pressure_hPa(sensors.height_m), 0.0, sensors.height_m, _ROOM_degC) if barometer else (0.0,) * 4
        updated = _INERTIAL | (_BAROMETER if barometer else 0)
        self._wire.send_fields(_SENSOR, self.time_us, *force, *rate, 0.0, 0.0, 0.0, *air, updated, 0)

    def _pilot(self) -> None:
        radio = self.radio_control
        if radio and radio.on and self.time_us // _STEP_us % PERIOD_STEPS == 0:
            self.send(RC_CHANNELS, *radio.fields(self.time_us))

    def miss(self, seconds: float) -> None:
        """PX4's clock follows its sensors' stamps: it sees a gap in them."""
        self.time_us += round(seconds / STEP_S) * _STEP_us

    def send(self, message_id: int, *fields: float) -> None:
        """Any other message that PX4's simulator port takes, its fields in the order of the wire."""
        self._wire.send_fields(message_id, *fields)

    def write(self, packet: bytes) -> None:
        """Where the dialect puts a packed message."""
        try:
            self._socket.sendall(packet)
        except OSError as error:
            raise Px4Lost(f"PX4 has closed the simulator's connection ({error.strerror})") from None

    def _receive(self, *, wait: bool) -> bool:
        """Take one message, or the bytes towards it; False where there is none and none is waited for."""
        frame = take_frame(self._stream)
        if frame is None:
            return self._read(wait=wait)
        message_id, payload = frame
        if message_id == _MOTORS:
            self._take_motors(payload)
        return True

    def _read(self, *, wait: bool) -> bool:
        if not wait and not select.select((self._socket,), (), (), 0.0)[0]:
            return False
        try:
            data = self._socket.recv(4096)
        except TimeoutError:
            told = (
                f"PX4 has not answered its sensors for {ANSWER_S:g} s: does something else use this host? See px4.log"
            )
            raise Px4Lost(told) from None
        except OSError as error:
            raise Px4Lost(f"PX4 is gone: {error.strerror}; see px4.log") from None
        if not data:
            raise Px4Lost("PX4 has ended; see px4.log")
        self._stream += data
        return True

    def _take_motors(self, payload: bytes) -> None:
        self._answered_us, _flags, *controls, mode = unpack(_MOTORS, payload)
        self.armed = bool(mode & _ARMED)
        self._motors = np.array(controls[:4]) if self.armed else np.zeros(4)


def _pressure_hPa(height_m: float) -> float:
    return _SEA_LEVEL_hPa * math.exp(-height_m / _SCALE_HEIGHT_M)
