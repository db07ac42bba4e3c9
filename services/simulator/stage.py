"""The simulated world and whoever flies it, one step of the autopilot after the other; the seeded noise of all sensors."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from schemas.simulation import Truth
from schemas.tracking import MocapFrame
from services.config import Config
from services.physics import GRAVITY_MPS2, Array, Z, conjugate, rotate
from services.simulator import imu, world
from services.simulator.autopilot import STEP_S, Sensors
from services.simulator.human import Behaviour
from services.simulator.pilot import Pilot
from services.simulator.quadrotor import QuadrotorState
from services.simulator.world import Told, WorldParams, WorldState

PHYSICS_STEPS = 4  # of 1 ms in each step of the autopilot
_LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


class Stage:
    """World and pilot together; the pilot is made for the vehicle where it stands."""

    def __init__(self, config: Config, pilot_of: Callable[[QuadrotorState], Pilot]) -> None:
        self.config = config
        self.params = WorldParams(
            config.vehicle.quadrotor,
            config.cable,
            config.simulator.handle,
            config.person.human,
            config.person.subject,
            config.person.behaviour,
        )
        self._noise = np.random.default_rng(config.system.seed)
        self._air = np.random.default_rng((config.system.seed, 1))  # apart: the stand-in has no barometer
        self.world = self._initial()
        self._pilot = pilot_of(self.world.robot)

    def behave(self, deeds: Behaviour) -> None:
        """What the person will do, counted from the moment in which they hold the handle."""
        self.params = replace(self.params, behaviour=deeds)

    def catch(self, by_m: float) -> None:
        """The cable is caught on something, and so much shorter from now on."""
        cable = replace(self.params.cable, rest_length_m=self.params.cable.rest_length_m - by_m)
        self.params = replace(self.params, cable=cable)

    def step(self, told: Told) -> None:
        """The physics under the pilot's motors, then a sample of the sensors for the pilot."""
        motors, v_before = self._pilot.motors(), self.world.robot.v_W
        for _ in range(PHYSICS_STEPS):
            self.world = world.step(self.world, motors, told, STEP_S / PHYSICS_STEPS, self.params)
        self._pilot.sense(self._sensed(v_before))

    def stand_still(self, seconds: float) -> None:
        """Nothing was calculated for so long: only clocks go on."""
        self._pilot.miss(seconds)

    def capture(self) -> MocapFrame:
        """One frame of motion capture."""
        p, robot, handle = self.config.simulator.mocap, self.world.robot, self.world.handle
        return MocapFrame.model_validate(
            {
                "robot": _body(*imu.mocap(robot.p_W, robot.q_WB_wxyz, self._noise.standard_normal(6), p)),
                "handle": _body(*imu.mocap(handle.p_W, _LEVEL, self._noise.standard_normal(6), p)),
            }
        )

    def truth(self) -> Truth:
        """The world as it is."""
        robot, handle, person = self.world.robot, self.world.handle, world.look(self.world, self.params)
        return Truth.model_validate(
            {
                "robot_position_m": _xyz(robot.p_W),
                "robot_velocity_mps": _xyz(robot.v_W),
                "robot_q_WB_wxyz": _wxyz(robot.q_WB_wxyz),
                "hand_position_m": _xyz(person.p_hand_W),
                "hand_velocity_mps": _xyz(person.v_hand_W),
                "handle_position_m": _xyz(handle.p_W),
                "handle_velocity_mps": _xyz(handle.v_W),
                "head_position_m": _xyz(person.p_head_W),
                "cable_force_N": _xyz(self.world.f_c_W),
                "hand_force_N": _xyz(world.hand_force(self.world, self.params)),
                "holding": person.holding,
                "subject": person.phase.value,
            }
        )

    def _initial(self) -> WorldState:
        """Vehicle under the start, handle laid out, subject clear behind."""
        path = self.config.guided_path
        ahead = path.t_hat(0.0)
        hand = path.p(0.0) - self.config.simulator.clear_of_start_m * ahead
        return world.initial(path.p(0.0), np.array(self.config.world.handle_start_m), hand, ahead, self.params)

    def _sensed(self, v_before: Array) -> Sensors:
        """What the inertial unit makes of the last step: the mean specific force, so that a touch-down is felt."""
        robot, p = self.world.robot, self.config.vehicle.imu
        felt_W = (robot.v_W - v_before) / STEP_S + GRAVITY_MPS2 * Z
        normal = self._noise.standard_normal((2, 3))
        return Sensors(
            imu.accelerometer(rotate(conjugate(robot.q_WB_wxyz), felt_W), normal[0], STEP_S, p),
            imu.gyroscope(robot.omega_B, normal[1], STEP_S, p),
            robot.q_WB_wxyz,
            height_m=imu.barometer(float(robot.p_W[2]), self._air.standard_normal()),
        )


# Messages are validated in one go from plain numbers, which costs half as much as making their parts one by one.


def _body(p_W: Array, q_WB_wxyz: Array) -> dict[str, object]:
    return {"tracked": True, "position_m": _xyz(p_W), "q_WB_wxyz": _wxyz(q_WB_wxyz)}


def _xyz(v: Array) -> dict[str, float]:
    return dict(zip("xyz", v.tolist(), strict=True))


def _wxyz(q: Array) -> dict[str, float]:
    return dict(zip("wxyz", q.tolist(), strict=True))
