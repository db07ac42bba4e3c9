"""The only one that talks to the vehicle: IMU and state out to the bus, set-points and poses in to the autopilot.

Four concurrent loops: relay of the IMU, relay of poses, the set-point loop (the admittance filter inside), and the orders
(mode, arming). If one of them fails, all end, the process ends, and the set-points with it.
"""

import asyncio
from dataclasses import dataclass

import numpy as np

from schemas.energy import EnergyBalance
from schemas.message import Quaternion, Vec3
from schemas.safety import Permit, Phase
from schemas.topics import (
    CABLE_FORCE,
    ENERGY,
    GUIDANCE,
    ROBOT_POSE,
    SAFETY_STATE,
    SETPOINT,
    VEHICLE_IMU,
    VEHICLE_STATE,
)
from schemas.vehicle import FlightMode, SetpointKind, VehicleImu, VehicleState
from schemas.vehicle import Setpoint as SetpointMessage
from services.config import Config
from services.px4_bridge import flight, orders, permits
from services.px4_bridge.flight import Force, Guidance
from services.px4_bridge.orders import Order
from services.px4_bridge.telemetry import ImuSample, VehicleSample
from services.px4_bridge.vehicle import MavsdkVehicle, Vehicle, VehicleError
from services.runtime.node import Node, Tick, used
from services.runtime.pace import Pace

ORDERS_RATE_HZ = 5.0


async def run(node: Node, config: Config) -> None:
    """Connect to the autopilot of the profile, then fly it until cancelled."""
    link = config.px4_bridge.link
    node.status = f"connecting to {link.url}"
    async with MavsdkVehicle.connect(link.url, config.px4_bridge.vehicle, node.clock.now_ns, link.timeout_s) as vehicle:
        await fly(node, config, vehicle)


async def fly(node: Node, config: Config, vehicle: Vehicle) -> None:
    """All four loops on a connected vehicle."""
    bridge = Bridge(node, config, vehicle)
    async with asyncio.TaskGroup() as loops:
        for loop in (bridge.relay_imu, bridge.relay_poses, bridge.stream_setpoints, bridge.give_orders):
            loops.create_task(loop())


@dataclass
class Word:
    """The supervisor's word as it counts now, shared by the set-point loop and the orders."""

    permit: Permit = Permit.NONE
    phase: Phase = Phase.IDLE


class Bridge:
    """The wiring of the four loops; the laws are in flight.py, orders.py and permits.py."""

    def __init__(self, node: Node, config: Config, vehicle: Vehicle) -> None:
        self._node, self._config, self._vehicle = node, config, vehicle
        self._params = flight.Params(
            config.px4_bridge.flight,
            config.px4_bridge.admittance,
            config.px4_bridge.approach,
            config.px4_bridge.limits,
            config.px4_bridge.tank,
        )
        self._safety, self._guidance = node.latest(SAFETY_STATE), node.latest(GUIDANCE)
        self._forces = node.queue(CABLE_FORCE)
        self._word = Word()
        self._told: VehicleState | None = None
        self._pace = Pace(VEHICLE_STATE.rate_Hz)
        self._flown, self._streaming_s = orders.Flown.NOT_YET, 0.0
        self._trouble = ""

    async def relay_imu(self) -> None:
        """Every inertial sample, as soon as it is there."""
        out = self._node.publisher(VEHICLE_IMU)
        while True:
            await self._vehicle.wait_imu()
            for sample in self._vehicle.drain_imu():
                out.publish(_imu(sample))

    async def relay_poses(self) -> None:
        """Every pose that the tracker vouches for."""
        async for pose in self._node.stream(ROBOT_POSE):
            if pose.valid:
                self._vehicle.send_pose(pose.position_m.array(), pose.q_WB_wxyz.array(), pose.stamp_ns)

    async def stream_setpoints(self) -> None:
        """The filter on each force sample, a set-point on each tick; nothing repeats either."""
        sent, balances = self._node.publisher(SETPOINT), self._node.publisher(ENERGY)
        balance_due = Pace(ENERGY.rate_Hz)
        state: flight.State | None = None
        last_force_ns = 0
        async for tick in self._node.ticks(SETPOINT.rate_Hz):
            robot = self.report_vehicle(tick)
            self._listen()
            forces, last_force_ns = self._new_forces(last_force_ns)
            self._flown = orders.flown(self._flown, self._word.permit, self._word.phase, robot.armed, robot.mode)
            if not orders.streams(self._word.permit, self._word.phase, robot.armed, robot.mode, self._flown):
                state, self._streaming_s = None, 0.0
                continue
            if state is None:  # what was felt before counts for nothing
                state, forces = flight.initial(robot.position_m.array(), self._params), []
            state, output = flight.step(state, self._input(forces), tick.dt_s, self._params)
            message = self._message(output, last_force_ns, tick, robot.seq)
            self._vehicle.send_setpoint(output.sent.p, output.sent.v, output.sent.a, message.yaw_rad)
            sent.publish(message)
            if balance_due.due(tick.stamp_ns):
                balances.publish(_balance(state.port, message))
            self._streaming_s += tick.dt_s

    def report_vehicle(self, tick: Tick) -> VehicleState:
        """Say the vehicle's state at its rate, and at once where its mode changed; the last that was said."""
        sample, told = self._vehicle.sample, self._told
        due = self._pace.due(tick.stamp_ns)
        if told is None or due or (sample.armed, sample.mode) != (told.armed, told.mode):
            told = self._told = self._node.publisher(VEHICLE_STATE).publish(_vehicle_state(sample))
        return told

    async def give_orders(self) -> None:
        """Mode and arming, one request at a time; a refusal is tried again and told."""
        async for _ in self._node.ticks(ORDERS_RATE_HZ):
            robot = self._vehicle.sample
            order = orders.next_order(self._word.permit, self._word.phase, robot.armed, robot.mode, self._streaming_s)
            try:
                await self._carry_out(order)
                self._trouble = ""
            except VehicleError as error:
                self._trouble = str(error)
            self._node.status = self._trouble or f"{robot.mode}, {self._word.permit}"

    async def _carry_out(self, order: Order) -> None:
        match order:
            case Order.OFFBOARD:
                await self._vehicle.set_mode(FlightMode.OFFBOARD)
            case Order.ARM:
                await self._vehicle.arm()
            case Order.LAND:
                await self._vehicle.set_mode(FlightMode.LAND)
            case Order.NOTHING:
                pass

    def _listen(self) -> None:
        """The supervisor's newest valid word, worth what its age allows."""
        link, heard = self._config.px4_bridge.link, self._safety.message
        if heard is None or not heard.valid:
            heard_permit, age_s = (self._word.permit, float("inf")) if heard else (None, float("inf"))
        else:
            heard_permit, age_s = heard.permit, self._safety.age_s
            self._word.phase = heard.phase
        self._word.permit = permits.effective(heard_permit, age_s, link.permit_silent_s, link.permit_lost_s)

    def _new_forces(self, last_ns: int) -> tuple[list[Force], int]:
        """Force samples since the last tick, with the time from one to the next."""
        forces: list[Force] = []
        for sample in self._forces.drain():
            dt_s = min(max((sample.stamp_ns - last_ns) * 1e-9, 1e-4), 0.1)
            last_ns = sample.stamp_ns
            if sample.valid:
                slack = sample.slack_m > self._config.force_estimator.bias.slack_margin_m
                forces.append(Force(sample.force_N.array(), slack, dt_s))
        return forces, last_ns

    def _input(self, forces: list[Force]) -> flight.Input:
        heard, command = self._safety.message, self._guidance.value
        return flight.Input(
            permit=self._word.permit,
            goal=heard.goal_m.array() if heard else np.zeros(3),
            speed_mps=heard.speed_mps if heard else 0.0,
            held=heard is not None and heard.held,
            forces=forces,
            force_fresh=self._forces.age_s < self._config.px4_bridge.link.force_silent_s,
            guidance=Guidance(command.p_R_d_m.array(), command.f_d_N.array(), command.scale) if command else None,
        )

    def _message(self, output: flight.Output, force_ns: int, tick: Tick, robot_seq: int) -> SetpointMessage:
        now_ns = self._node.turn.now_ns()
        complies = output.kind is not SetpointKind.POSITION
        return SetpointMessage(
            stamp_ns=now_ns,
            inputs=used(self._forces, self._guidance, self._safety, tick=tick) | {VEHICLE_STATE.key: robot_seq},
            kind=output.kind,
            position_m=Vec3.of(output.sent.p),
            velocity_mps=Vec3.of(output.sent.v),
            acceleration_mps2=Vec3.of(output.sent.a),
            yaw_rad=self._config.px4_bridge.flight.yaw_rad,
            u_R_mps2=Vec3.of(output.u_R),
            u_A_N=Vec3.of(output.u_A),
            feed_forward=output.feed_forward,
            age_s=(now_ns - force_ns) * 1e-9 if complies and force_ns else 0.0,
        )


def _balance(port: flight.Port, sent: SetpointMessage) -> EnergyBalance:
    """The books as they stood when the set-point left."""
    balance = port.balance
    return EnergyBalance(
        stamp_ns=sent.stamp_ns,
        inputs=sent.inputs,
        stored_J=balance.stored_J,
        handed_J=balance.handed_J,
        guidance_J=balance.guidance_J,
        height_J=balance.height_J,
        cable_J=balance.cable_J,
        dissipated_J=balance.dissipated_J,
        residual_J=balance.residual_J,
        created_J=balance.created_J,
        tank_J=port.tank.level_J,
        tank_scale=port.tank.scale,
        damping_Ns_per_m=Vec3.of(port.damping),
    )


def _imu(sample: ImuSample) -> VehicleImu:
    return VehicleImu(
        stamp_ns=sample.stamp_ns,
        specific_force_B_mps2=Vec3.of(sample.specific_force_B),
        angular_rate_B_rad_s=Vec3.of(sample.angular_rate_B),
        q_WB_wxyz=Quaternion.of(sample.q_WB_wxyz),
        thrust_N=sample.thrust_N,
        thrust_source=sample.thrust_source,
        throttle_mean=sample.throttle.mean,
        throttle_square_mean=sample.throttle.square,
    )


def _vehicle_state(sample: VehicleSample) -> VehicleState:
    return VehicleState(
        stamp_ns=sample.stamp_ns,
        valid=sample.connected and sample.has_position,
        invalid_reason=_trouble(sample),
        connected=sample.connected,
        armed=sample.armed,
        in_air=sample.in_air,
        mode=sample.mode,
        position_m=Vec3.of(sample.p_W),
        velocity_mps=Vec3.of(sample.v_W),
        q_WB_wxyz=Quaternion.of(sample.q_WB_wxyz),
        battery_fraction=sample.battery_fraction,
        battery_V=sample.battery_V,
    )


def _trouble(sample: VehicleSample) -> str:
    if not sample.connected:
        return "no heartbeat from the autopilot"
    return "" if sample.has_position else "the autopilot has no position: does it get poses?"
