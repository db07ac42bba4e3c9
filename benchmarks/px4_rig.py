"""A rig round real PX4: the vehicle flies under any force from outside, the bridge's own laws make its set-points.

No services: PX4 is in lockstep with the physics. But it takes messages up in threads that follow the host's clock, so a
delay of a millisecond is several of a flight that runs several times as fast as the world: a rig is held to `pace` times
real time. What PX4 knows it knows from its messages and from motion capture, noise included; the force estimate is the
observer's, from PX4's attitude, motor outputs and accelerometer.
"""

import asyncio
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from schemas.vehicle import FlightMode
from services.config import Config
from services.force_estimator import observer
from services.physics import GRAVITY_MPS2, Array, Z, conjugate, rotate
from services.px4_bridge import admittance, setpoint, telecommand
from services.px4_bridge.admittance import Admittance, Command
from services.rehearsal.px4_vehicle import Px4Vehicle
from services.simulator import imu, px4_process, quadrotor
from services.simulator.autopilot import STEP_S, Sensors
from services.simulator.px4_hil import Px4Hil
from services.simulator.quadrotor import QuadrotorState

Force = Callable[[QuadrotorState], Array]
PHYSICS_STEPS, SETPOINT_STEPS, POSE_STEPS, ORDER_STEPS = 4, 2, 4, 125
NOTHING = np.zeros(3)
NO_FORCE: Force = lambda _state: NOTHING  # noqa: E731


@contextmanager
def px4(config: Config, folder: Path) -> Generator[Px4Hil]:
    """PX4 started with the profile's parameters, and waiting for its first sensors."""
    sitl = config.simulator.px4_sitl
    assert sitl is not None, "the profile does not simulate with PX4"
    with asyncio.Runner() as runner:
        context = px4_process.connected(sitl, config.vehicle, config.px4_bridge.px4, str(folder))
        yield runner.run(context.__aenter__())
        runner.run(context.__aexit__(None, None, None))


class Rig:
    """One vehicle that PX4 flies; `tick` is 4 ms."""

    def __init__(self, config: Config, hil: Px4Hil, M_A_kg: float, pace: float = 1.0) -> None:
        self.config, self.hil = config, hil
        self.body = config.vehicle.quadrotor
        self.filter: Admittance = replace(config.px4_bridge.admittance, M_A_kg=M_A_kg)
        self.state = quadrotor.at_rest(self.body.gear_height_m * Z, self.body)
        self.reference = admittance.engage(self.state.p_W)
        self.seen = observer.start()
        self.estimating = 0.0
        """How much of the felt force is fed to filter and set-point, 0 to 1."""
        port = int(config.px4_bridge.link.url.rsplit(":", 1)[1])
        self.vehicle = Px4Vehicle(config.px4_bridge.vehicle, lambda: 1000 * hil.time_us + 1, hil, port)
        self._random = np.random.default_rng(config.system.seed)
        self._ticks, self._p_sent = 0, self.state.p_W
        self._period_s, self._due_s = STEP_S / pace, time.monotonic()

    def tick(self, command: Command, force: Force = NO_FORCE) -> None:
        """The physics under PX4's motors and `force`, the laws on what PX4 says, a set-point, a pose."""
        self._due_s = max(self._due_s + self._period_s, time.monotonic() - STEP_S)
        time.sleep(max(0.0, self._due_s - time.monotonic()))
        motors, v_before = self.vehicle.motors(), self.state.v_W
        for _ in range(PHYSICS_STEPS):
            self.state = quadrotor.step(self.state, motors, force(self.state), STEP_S / PHYSICS_STEPS, self.body)
        self.vehicle.sense(self._sensed(v_before))
        for sample in self.vehicle.drain_imu():
            self.seen, f_c = observer.step(
                self.seen,
                sample.specific_force_B,
                sample.q_WB_wxyz,
                sample.thrust_N,
                STEP_S,
                self.config.force_estimator.observer,
            )
            felt = self.estimating * f_c
            self.reference, _ = admittance.step(self.reference, felt, command, False, STEP_S, np.inf, self.filter)
        self._say(command)

    def take_off(self, p_W: Array, seconds: float = 8.0) -> None:
        """Armed in offboard mode, to a hover at `p_W`; the force estimate then begins to count. Raises RuntimeError."""
        here = admittance.wait(p_W, 0.0, self.filter)
        for n in range(round(40.0 / STEP_S)):
            self.tick(here)
            now = self.vehicle.sample
            if not (now.armed and now.mode is FlightMode.OFFBOARD):
                self.reference = admittance.engage(self.state.p_W)
                if n % ORDER_STEPS == 0:
                    self.vehicle.ask_rates()
                    self.vehicle.order(telecommand.mode(FlightMode.OFFBOARD))
                    self.vehicle.order(telecommand.command(telecommand.ARM, 1.0))
            elif float(np.linalg.norm(self.state.p_W - p_W)) < 0.1:
                break
        else:
            raise RuntimeError(f"PX4 did not take off: {'; '.join(self.vehicle.drain_texts())}")
        for _ in range(round(seconds / STEP_S)):
            self.tick(here)
            self.estimating = min(self.estimating + STEP_S / seconds, 1.0)

    def _say(self, command: Command) -> None:
        self._ticks += 1
        if self._ticks % SETPOINT_STEPS == 0:
            limits, m_R = self.config.px4_bridge.limits, self.body.mass_kg
            f_c = -self.estimating * self.seen.f_ext
            b = admittance.damping(self.reference, command, self.filter)
            led = setpoint.ahead(self.reference, b, self.filter.M_A_kg, self.config.px4_bridge.flight.lead_s)
            sent = setpoint.setpoint(led, f_c, m_R, 1.0, self._p_sent, limits)
            self._p_sent = sent.p
            self.vehicle.send_setpoint(sent.p, sent.v, sent.a, 0.0)
        if self._ticks % POSE_STEPS == 0:
            normal = self._random.standard_normal(6)
            pose = imu.mocap(self.state.p_W, self.state.q_WB_wxyz, normal, self.config.simulator.mocap)
            self.vehicle.send_pose(*pose, 0)

    def _sensed(self, v_before: Array) -> Sensors:
        felt_W = (self.state.v_W - v_before) / STEP_S + GRAVITY_MPS2 * Z
        normal, p = self._random.standard_normal((2, 3)), self.config.vehicle.imu
        height_m = imu.barometer(float(self.state.p_W[2]), self._random.standard_normal())
        return Sensors(
            imu.accelerometer(rotate(conjugate(self.state.q_WB_wxyz), felt_W), normal[0], STEP_S, p),
            imu.gyroscope(self.state.omega_B, normal[1], STEP_S, p),
            self.state.q_WB_wxyz,
            height_m=height_m,
        )
