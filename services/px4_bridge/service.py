"""The only one that talks to the vehicle: IMU and state out to the bus, set-points and poses in to the autopilot.

Five concurrent loops: relay of the IMU, relay of poses, the set-point loop (the admittance filter inside), the orders
(mode, arming), and the one that stops the motors. If one of them fails, all end, the process ends, and the set-points with
it. A person's `kill` is heard here too, so that it works without a supervisor.
"""

import asyncio
import logging

from schemas.topics import ENERGY, PARAMETERS, ROBOT_POSE, SETPOINT, VEHICLE_IMU, VEHICLE_STATE
from schemas.vehicle import FlightMode, VehicleState
from services.config import Config
from services.physics import norm
from services.px4_bridge import flight, orders, preflight, said
from services.px4_bridge.ears import Ears
from services.px4_bridge.orders import Order
from services.px4_bridge.vehicle import MavsdkVehicle
from services.px4_bridge.vehicle_protocol import Vehicle, VehicleError
from services.runtime.node import Node, Tick
from services.runtime.pace import Pace

ORDERS_RATE_HZ, KILL_RATE_HZ = 5.0, 25.0


async def run(node: Node, config: Config) -> None:
    """Connect to the autopilot of the profile, then fly it until cancelled."""
    link = config.px4_bridge.link
    node.status = f"connecting to {link.url}"
    connection = MavsdkVehicle.connect(
        link.url, config.px4_bridge.vehicle, node.clock.now_ns, link.timeout_s, tell_time=bool(config.hosts)
    )
    async with connection as vehicle:
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
            bridge.say_parameters,
        ):
            loops.create_task(loop())


class Bridge:
    """The wiring of the loops; the laws are in flight.py, orders.py, permits.py and trust.py."""

    def __init__(self, node: Node, config: Config, vehicle: Vehicle) -> None:
        self._node, self._config, self._vehicle = node, config, vehicle
        self._params = flight.Params(
            config.px4_bridge.flight,
            config.px4_bridge.admittance,
            config.px4_bridge.approach,
            config.px4_bridge.limits,
            config.px4_bridge.tank,
        )
        self._ears = Ears(node, config)
        self._word = self._ears.word
        self._told: VehicleState | None = None
        self._pace = Pace(VEHICLE_STATE.rate_Hz)
        self._flown, self._streaming_s = orders.Flown.LEFT, 0.0
        self._trouble = ""

    async def say_parameters(self) -> None:
        """Once, for the recording: how the vehicle was set. One that does not give them flies all the same.

        Not of one that flies already: a thousand answers would be in the way of its set-points. Raises VehicleError for one
        that is no quadrotor with PX4, once it says so.
        """
        async for _ in self._node.ticks(ORDERS_RATE_HZ):
            if self._vehicle.sample.connected:
                break
        self._refuse_another_kind()
        if self._vehicle.sample.armed:
            return
        try:
            self._node.publisher(PARAMETERS).publish(said.parameters(await self._vehicle.get_parameters()))
        except VehicleError as error:
            logging.getLogger(self._node.name).warning("%s: they are not recorded", error)

    def _refuse_another_kind(self) -> None:
        checks = self._vehicle.checks
        for what, cure in preflight.kind(checks.autopilot, checks.vehicle_type):
            raise VehicleError(f"{what}: {cure}")

    async def relay_imu(self) -> None:
        """Every inertial sample, as soon as it is there."""
        out = self._node.publisher(VEHICLE_IMU)
        while True:
            await self._vehicle.wait_imu()
            for sample in self._vehicle.drain_imu():
                out.publish(said.imu(sample))

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
        sent, balances = self._node.publisher(SETPOINT), self._node.publisher(ENERGY)
        balance_due, ears = Pace(ENERGY.rate_Hz), self._ears
        state: flight.State | None = None
        sent_ns = 0
        async for tick in self._node.ticks(SETPOINT.rate_Hz):
            robot, word = self.report_vehicle(tick), ears.listen()
            forces = ears.new_forces(robot.in_air)
            silent_s = (self._node.turn.now_ns() - sent_ns) * 1e-9 if sent_ns else 0.0
            armed = robot.armed or not robot.connected  # who has not been heard may fly
            self._flown = orders.flown(self._flown, word.permit, word.phase, armed, robot.mode, silent_s)
            if not orders.streams(word.permit, word.phase, armed, robot.mode, self._flown):
                state, self._streaming_s = None, 0.0
                ears.forget()
                continue
            if state is None:  # what was felt before counts for nothing
                state, forces = flight.initial(robot.position_m.array(), self._params), []
                ears.forget()
            state, output = flight.step(state, ears.input(forces, robot, state), tick.dt_s, self._params)
            inputs = ears.inputs(tick) | {VEHICLE_STATE.key: robot.seq}
            yaw_rad = self._params.flight.yaw_rad
            sent_ns = self._node.turn.now_ns()
            message = said.setpoint(output, yaw_rad, ears.force_ns, sent_ns, inputs)
            if self._node.clock.now_ns() - sent_ns > 1e9 * orders.SILENCE_S:  # it stood still in this very turn
                state = None
                continue
            self._vehicle.send_setpoint(output.sent.p, output.sent.v, output.sent.a, yaw_rad)
            sent.publish(message)
            if balance_due.due(tick.stamp_ns):
                balances.publish(said.balance(state.port, message))
            self._streaming_s += tick.dt_s

    def report_vehicle(self, tick: Tick) -> VehicleState:
        """Say the vehicle's state at its rate, and at once where its mode changed; the last that was said."""
        sample, told = self._vehicle.sample, self._told
        due = self._pace.due(tick.stamp_ns)
        if told is None or due or (sample.armed, sample.mode) != (told.armed, told.mode):
            told = self._told = self._node.publisher(VEHICLE_STATE).publish(said.vehicle_state(sample))
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
                if not self._vehicle.sample.armed:  # without a place on earth PX4 refuses a pilot Hold
                    await self._vehicle.set_origin()
                await self._vehicle.set_mode(FlightMode.OFFBOARD)
            case Order.ARM:
                await self._vehicle.arm()
            case Order.LAND:
                await self._vehicle.set_mode(FlightMode.LAND)
            case Order.NOTHING:
                pass
