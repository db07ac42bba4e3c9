"""A vehicle in process: the bridge's Vehicle on one side, the stand-in autopilot's Link on the other, no MAVLink.

It speaks in the same messages as the real connection, so that decoding, masks and mode reports are the same; only the
wire is missing. Time is the event loop's, so it runs on virtual time; what is sent takes `delay_s` each way. Heartbeats
come with every step, so that orders are seen at once.
"""

import asyncio
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from schemas import frames
from schemas.vehicle import FlightMode, ThrustSource
from services.px4_bridge import telecommand, telemetry
from services.px4_bridge.vehicle_protocol import VehicleError
from services.rehearsal.rehearsed_vehicle import Messages, RehearsedVehicle
from services.simulator import mavlink_orders
from services.simulator.autopilot import Answer, AutopilotState, Input, Output, Pose, Sensors, Target
from services.simulator.cascade import Setpoint
from services.simulator.commander import Ack, Request, SetOrigin, SetParameter
from services.simulator.mavlink_streams import (
    CUSTOM_MODE,
    PREARM,
    PX4,
    QUADROTOR,
    VERSION,
    accuracy_m,
    has_begun,
    pwm_us,
    system_status,
)

Array = NDArray[np.float64]


class DirectVehicle(RehearsedVehicle):
    """Both ends at once: hand it to `px4_bridge.service.fly` and to `simulator.service.play`."""

    def __init__(self, p: telemetry.Vehicle, now_ns: Callable[[], int], delay_s: float = 0.0) -> None:
        super().__init__(p, now_ns)
        self._delay_s = delay_s
        self._to_vehicle: list[Input] = []
        self._waiting: dict[int, asyncio.Future[Ack]] = {}
        self._px4: dict[str, int | float] = {}
        self._tickets = 0
        self._steps = 0
        self.setpoints: list[Setpoint] = []
        """All set-points that were sent."""
        self.refuses: tuple[type[Request], ...] = ()
        """Requests that the autopilot denies."""

    # The autopilot's side.

    def receive(self) -> list[Input]:
        inputs, self._to_vehicle = self._to_vehicle, []
        return inputs

    def send(self, state: AutopilotState, sensors: Sensors, output: Output) -> None:
        self._steps += 1
        messages = self.garble(_messages(state, sensors, self._steps, self._p))
        self._is_in(FlightMode(state.commander.mode.value), state.commander.armed)
        self._px4 = dict(state.px4)
        self._pass(lambda: self._arrive(partial(self._take, messages, output)))

    def _take(self, messages: Messages, output: Output) -> None:
        self._heard([*messages, *(("STATUSTEXT", {"text": text}) for text in output.texts)])
        for answer in output.answers:
            self._settle(answer)
        self._wake()

    def _settle(self, answer: Answer) -> None:
        done = self._waiting.pop(answer.request.ticket, None)
        if done is not None and not done.done():
            done.set_result(answer.ack)

    # The bridge's side.

    def send_setpoint(self, p_W: Array | None, v_W: Array | None, a_W: Array | None, yaw_rad: float | None) -> None:
        telecommand.setpoint(p_W, v_W, a_W, yaw_rad)  # refuses what the wire would refuse
        unset = np.full(3, np.nan)
        p, v, a = (unset if vector is None else vector.copy() for vector in (p_W, v_W, a_W))
        setpoint = Setpoint(p, v, a, np.array(np.nan if yaw_rad is None else yaw_rad))
        self.setpoints.append(setpoint)
        self.sent_ns.append(self._now_ns())
        if not self.mute:
            self._put(Target(setpoint))

    def send_pose(self, p_W: Array, q_WB_wxyz: Array, stamp_ns: int) -> None:
        self._put(Pose(p_W.copy(), (self._now_ns() - stamp_ns) * 1e-9 + self._delay_s))

    async def set_origin(self) -> None:
        self._put(SetOrigin())

    async def ask_version(self) -> None:
        self._telemetry.take("AUTOPILOT_VERSION", {"flight_sw_version": VERSION}, self._now_ns())

    async def arming_problems(self) -> list[str]:
        raise VehicleError("arming checks: unsupported")

    async def get_parameters(self) -> dict[str, int | float]:
        await self._until(lambda: bool(self._px4))
        return dict(self._px4)

    async def get_parameter(self, name: str) -> int | float:
        if name not in self._px4:
            raise VehicleError(f"parameter {name}: unknown")
        return self._px4[name]

    async def set_parameter(self, name: str, value: int | float) -> None:
        await self._accepted(f"parameter {name} = {value}", self._answered(SetParameter(name, value)))

    async def _acknowledged(self, fields: telemetry.Fields) -> int:
        asked = mavlink_orders.request(fields["command"], *(fields[f"param{n}"] for n in (1, 2, 3)))
        assert asked is not None, fields
        return await self._answered(asked)

    async def _answered(self, asked: Request) -> int:
        if isinstance(asked, self.refuses):
            return Ack.DENIED
        self._tickets += 1
        done = self._waiting[self._tickets] = asyncio.get_running_loop().create_future()
        self._put(asked._replace(ticket=self._tickets))
        return await done

    def pilot(self, asked: Request) -> None:
        self._to_vehicle.append(asked)

    def refuse(self, kind: type[Request]) -> None:
        self.refuses = (*self.refuses, kind)

    def drain(self, percent: int) -> None:
        self.garble = lambda messages: [
            (name, {**fields, "battery_remaining": percent} if name == "BATTERY_STATUS" else fields)
            for name, fields in messages
        ]

    def _put(self, item: Input) -> None:
        self._pass(lambda: self._to_vehicle.append(item))

    def _pass(self, deliver: Callable[[], None]) -> None:
        if self.cut:
            return
        if self._delay_s > 0.0:
            asyncio.get_running_loop().call_later(self._delay_s, deliver)
        else:
            deliver()


def _messages(state: AutopilotState, sensors: Sensors, n: int, p: telemetry.Vehicle) -> Messages:
    """What the wire would carry after the n-th step, at PX4's rates, inertial sample last."""
    q = frames.q_ned_frd_from_enu_flu(sensors.q_WB_wxyz).tolist()
    messages: Messages = [
        (
            "HEARTBEAT",
            {
                "base_mode": 129 if state.commander.armed else 1,
                "custom_mode": CUSTOM_MODE[state.commander.mode],
                "system_status": system_status(state.commander),
                "type": QUADROTOR,
                "autopilot": PX4,
            },
        ),
        ("EXTENDED_SYS_STATE", {"landed_state": 1 if state.ground.landed else 2}),
        ("ATTITUDE_QUATERNION", dict(zip(("q1", "q2", "q3", "q4"), q, strict=True))),
        _thrust(state, p),
    ]
    if n % 250 == 1:
        stated_m = accuracy_m(state)
        messages += [
            ("BATTERY_STATUS", {"battery_remaining": round(100 * sensors.battery_fraction)}),
            ("SYS_STATUS", {"onboard_control_sensors_health": PREARM if state.has_position else 0}),
            ("ESTIMATOR_STATUS", {"pos_horiz_accuracy": stated_m, "pos_vert_accuracy": stated_m}),
        ]
    if n % 2 == 0 and has_begun(state):
        messages.append(("LOCAL_POSITION_NED", {"time_boot_ms": int(1000 * state.t_s)} | _position(state)))
    return [*messages, ("HIGHRES_IMU", _imu(state, sensors))]


def _thrust(state: AutopilotState, p: telemetry.Vehicle) -> tuple[str, telemetry.Fields]:
    if p.thrust_source is ThrustSource.ATTITUDE_TARGET:
        return "ATTITUDE_TARGET", {"thrust": float(state.motors.mean())}
    return "ACTUATOR_OUTPUT_STATUS", {"actuator": pwm_us(state)}


def _position(state: AutopilotState) -> dict[str, float]:
    position = frames.ned_from_enu(state.estimate.p_W).tolist() + frames.ned_from_enu(state.estimate.v_W).tolist()
    return dict(zip(("x", "y", "z", "vx", "vy", "vz"), position, strict=True))


def _imu(state: AutopilotState, sensors: Sensors) -> telemetry.Fields:
    values = frames.frd_from_flu(np.array((sensors.specific_force_B, sensors.omega_B))).ravel().tolist()
    names = ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro")
    return {"time_usec": round(1e6 * state.t_s), "id": 0} | dict(zip(names, values, strict=True))
