"""The only one that talks to the vehicle: IMU and state out to the bus, set-points and poses in to the autopilot.

Five concurrent loops: relay of the IMU, relay of poses, the set-point loop (the admittance filter inside), the orders
(mode, arming), and the one that stops the motors. If one of them fails, all end, the process ends, and the set-points with
it. A person's `kill` is heard here too, so that it works without a supervisor.
"""

import asyncio
from dataclasses import dataclass

import numpy as np

from schemas.message import Quaternion, Vec3
from schemas.safety import Action, Permit, Phase
from schemas.topics import (
    CABLE_FORCE,
    GUIDANCE,
    HANDLE_STATE,
    REQUEST,
    ROBOT_POSE,
    SAFETY_STATE,
    SETPOINT,
    VEHICLE_IMU,
    VEHICLE_STATE,
)
from schemas.tracking import HandleSource
from schemas.vehicle import FlightMode, SetpointKind, VehicleImu, VehicleState
from schemas.vehicle import Setpoint as SetpointMessage
from services.config import Config
from services.physics import norm
from services.px4_bridge import flight, orders, permits
from services.px4_bridge.flight import Force, Guidance
from services.px4_bridge.leash import Hand
from services.px4_bridge.orders import Order
from services.px4_bridge.telemetry import ImuSample, VehicleSample
from services.px4_bridge.trust import credible_force, credible_guidance
from services.px4_bridge.vehicle import MavsdkVehicle, Vehicle, VehicleError
from services.runtime.node import Node, used
from services.runtime.pace import Pace

ORDERS_RATE_HZ, KILL_RATE_HZ = 5.0, 25.0
HAND_MEMORY_S = 1.0  # long enough to back off by


async def run(node: Node, config: Config) -> None:
    """Connect to the autopilot of the profile, then fly it until cancelled."""
    link = config.px4_bridge.link
    node.status = f"connecting to {link.url}"
    async with MavsdkVehicle.connect(link.url, config.px4_bridge.vehicle, node.clock.now_ns, link.timeout_s) as vehicle:
        await fly(node, config, vehicle)


async def fly(node: Node, config: Config, vehicle: Vehicle) -> None:
    """All loops on a connected vehicle."""
    bridge = Bridge(node, config, vehicle)
    async with asyncio.TaskGroup() as loops:
        for loop in (
            bridge.relay_imu,
            bridge.relay_poses,
            bridge.stream_setpoints,
            bridge.give_orders,
            bridge.stop_motors,
        ):
            loops.create_task(loop())


@dataclass
class Word:
    """The supervisor's word as it counts now, shared by the set-point loop and the orders."""

    permit: Permit = Permit.NONE
    said: Permit | None = None
    phase: Phase = Phase.IDLE
    fresh_ns: int = 0
    """When a word was last true and new."""
    killed: bool = False
    """By a person, and for good: flying again needs a new start of this service."""


class Bridge:
    """The wiring of the four loops; the laws are in flight.py, orders.py and permits.py."""

    def __init__(self, node: Node, config: Config, vehicle: Vehicle) -> None:
        self._node, self._config, self._vehicle = node, config, vehicle
        self._params = flight.Params(
            config.px4_bridge.flight, config.px4_bridge.admittance, config.px4_bridge.approach, config.px4_bridge.limits
        )
        self._safety, self._guidance = node.latest(SAFETY_STATE), node.latest(GUIDANCE)
        self._handle = node.latest(HANDLE_STATE)
        self._seen: Hand | None = None
        self._seen_ns = 0
        self._forces, self._requests = node.queue(CABLE_FORCE), node.queue(REQUEST)
        self._word, self._now_ns = Word(), node.clock.now_ns
        self._streaming_s = 0.0
        self._trouble = ""

    async def relay_imu(self) -> None:
        """Every inertial sample, as soon as it is there."""
        out = self._node.publisher(VEHICLE_IMU)
        while True:
            await self._vehicle.wait_imu()
            for sample in self._vehicle.drain_imu():
                out.publish(_imu(sample))

    async def relay_poses(self) -> None:
        """Every pose that the tracker vouches for, and that does not contradict a vehicle that flies: it would chase it."""
        apart_m = self._config.px4_bridge.trust.pose_apart_m
        async for pose in self._node.stream(ROBOT_POSE):
            robot = self._vehicle.sample
            apart = robot.armed and robot.has_position and norm(pose.position_m.array() - robot.p_W) > apart_m
            if apart:
                self._node.reject(ROBOT_POSE.key, f"position_m = {pose.position_m}: the vehicle is at {robot.p_W}")
            elif pose.valid:
                self._vehicle.send_pose(pose.position_m.array(), pose.q_WB_wxyz.array(), pose.stamp_ns)

    async def stream_setpoints(self) -> None:
        """The filter on each force sample, a set-point on each tick; nothing repeats either."""
        states, sent = self._node.publisher(VEHICLE_STATE), self._node.publisher(SETPOINT)
        state: flight.State | None = None
        last_force_ns, pace = self._node.clock.now_ns(), Pace(VEHICLE_STATE.rate_Hz)
        async for tick in self._node.ticks(SETPOINT.rate_Hz):
            robot = self._vehicle.sample
            if pace.due(tick.stamp_ns):
                states.publish(_vehicle_state(robot))
            self._listen()
            forces, last_force_ns = self._new_forces(last_force_ns)
            if not orders.streams(self._word.permit, self._word.phase, robot.armed, robot.mode):
                state, self._streaming_s = None, 0.0
                continue
            state = state or flight.initial(robot.p_W)
            state, output = flight.step(state, self._input(forces, last_force_ns, state), tick.dt_s, self._params)
            message = self._message(output, last_force_ns)
            self._vehicle.send_setpoint(output.sent.p, output.sent.v, output.sent.a, message.yaw_rad)
            sent.publish(message)
            self._streaming_s += tick.dt_s

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

    async def stop_motors(self) -> None:
        """Beside the orders, because one of them may wait for its answer when a person wants the motors stopped."""
        standing_s = 0.0
        async for tick in self._node.ticks(KILL_RATE_HZ):
            robot = self._vehicle.sample
            left = orders.forgotten(self._word.phase, robot.armed, robot.in_air)
            standing_s = standing_s + tick.dt_s if left else 0.0
            try:
                if orders.kills(self._word.permit, robot.armed):
                    await self._vehicle.kill()
                elif standing_s > orders.FORGOTTEN_S:
                    await self._vehicle.disarm()
            except VehicleError as error:
                self._trouble = str(error)

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
        link, heard, word, now_ns = self._config.px4_bridge.link, self._safety.message, self._word, self._now_ns()
        ages_s = abs(self._safety.age_s), (now_ns - self._safety.received_ns) * 1e-9  # a clock may be wrong either way
        if heard is not None and heard.valid and max(ages_s) <= link.permit_silent_s:
            word.said, word.phase, word.fresh_ns = heard.permit, heard.phase, min(heard.stamp_ns, now_ns)
        age_s = (now_ns - word.fresh_ns) * 1e-9
        permit = permits.effective(word.said, age_s, link.permit_silent_s, link.permit_lost_s)
        asked = any(request.action is Action.KILL for request in self._requests.drain())
        word.killed |= asked or permit is Permit.KILL
        word.permit = Permit.KILL if word.killed else permit

    def _new_forces(self, last_ns: int) -> tuple[list[Force], int]:
        """Force samples that can be true, since the last tick, with the time from one to the next."""
        forces: list[Force] = []
        for sample in self._forces.drain():
            f_c = sample.force_N.array()
            if not credible_force(f_c, self._config.px4_bridge.trust):
                if self._vehicle.sample.in_air:  # the ground carries what no cable can
                    self._node.reject(CABLE_FORCE.key, f"force_N = {f_c}: no cable pulls like that")
            elif sample.valid:
                dt_s = min(max((sample.stamp_ns - last_ns) * 1e-9, 1e-4), 0.1)
                last_ns = sample.stamp_ns
                slack = sample.slack_m > self._config.force_estimator.bias.slack_margin_m
                forces.append(Force(f_c, slack, dt_s))
        return forces, last_ns

    def _input(self, forces: list[Force], last_force_ns: int, state: flight.State) -> flight.Input:
        heard = self._safety.message
        return flight.Input(
            permit=self._word.permit,
            goal=heard.goal_m.array() if heard else np.zeros(3),
            speed_mps=heard.speed_mps if heard else 0.0,
            held=heard is not None and heard.held,
            forces=forces,
            force_fresh=self._now_ns() - last_force_ns < 1e9 * self._config.px4_bridge.link.force_silent_s,
            guidance=self._guided(state),
            hand=self._hand(),
        )

    def _guided(self, state: flight.State) -> Guidance | None:
        """What the ground asks for, where it is fresh and can be meant."""
        command = self._guidance.value
        if command is None:
            return None
        guidance = Guidance(command.p_R_d_m.array(), command.f_d_N.array(), command.scale)
        if credible_guidance(guidance, state.filter.p, self._config.px4_bridge.trust):
            return guidance
        self._node.reject(GUIDANCE.key, f"p_R_d_m = {guidance.p_R_d}, f_d_N = {guidance.f_d}: cannot be meant")
        return None

    def _hand(self) -> Hand | None:
        """Where motion capture sees the handle, or saw it a moment ago."""
        handle, now_ns = self._handle.value, self._now_ns()
        if handle is not None and handle.source is HandleSource.MOCAP:
            p_H = handle.position_m.array()
            inside = norm(p_H - self._vehicle.sample.p_W) < self._config.safety_supervisor.envelope.rotor_tip_m
            if not inside:  # else what is seen there is the vehicle itself
                self._seen, self._seen_ns = Hand(p_H, np.zeros(3)), now_ns
                return Hand(p_H, handle.velocity_mps.array())
        return self._seen if now_ns - self._seen_ns < HAND_MEMORY_S * 1e9 else None

    def _message(self, output: flight.Output, force_ns: int) -> SetpointMessage:
        now_ns = self._node.clock.now_ns()
        complies = output.kind is not SetpointKind.POSITION
        return SetpointMessage(
            stamp_ns=now_ns,
            inputs=used(self._forces, self._guidance, self._safety),
            kind=output.kind,
            position_m=Vec3.of(output.sent.p),
            velocity_mps=Vec3.of(output.sent.v),
            acceleration_mps2=Vec3.of(output.sent.a),
            yaw_rad=self._config.px4_bridge.flight.yaw_rad,
            u_R_mps2=Vec3.of(output.u_R),
            u_A_N=Vec3.of(output.u_A),
            feed_forward=output.feed_forward,
            age_s=(now_ns - force_ns) * 1e-9 if complies else 0.0,
        )


def _imu(sample: ImuSample) -> VehicleImu:
    return VehicleImu(
        stamp_ns=sample.stamp_ns,
        specific_force_B_mps2=Vec3.of(sample.specific_force_B),
        angular_rate_B_rad_s=Vec3.of(sample.angular_rate_B),
        q_WB_wxyz=Quaternion.of(sample.q_WB_wxyz),
        thrust_N=sample.thrust_N,
        thrust_source=sample.thrust_source,
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
    )


def _trouble(sample: VehicleSample) -> str:
    if not sample.connected:
        return "no heartbeat from the autopilot"
    return "" if sample.has_position else "the autopilot has no position: does it get poses?"
