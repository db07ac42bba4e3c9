"""The stand-in autopilot on the 0.8 kg quadrotor, without any link: what the tests of the vehicle fly."""

from collections.abc import Callable

import numpy as np

from services.config import load_vehicle
from services.physics import GRAVITY_MPS2, Array, rotation_matrix
from services.simulator import autopilot, quadrotor
from services.simulator.autopilot import STEP_S, Answer, Autopilot, Input, Output, Pose, Sensors, Target
from services.simulator.cascade import Setpoint
from services.simulator.commander import Ack, Arm, Commander, Mode, Request, Switch
from services.simulator.estimator import Estimator

PX4 = {
    "COM_OF_LOSS_T": 0.5,
    "COM_OBL_RC_ACT": 4,
    "COM_DISARM_LAND": 2.0,
    "COM_DISARM_PRFLT": 10.0,
    "COM_KILL_DISARM": 0.0,
    "COM_RC_IN_MODE": 0,
    "MPC_LAND_SPEED": 0.7,
    "MPC_ACC_DECOUPLE": 0,
}
ABOVE = np.array([0.0, 0.0, 1.0])


def parameters(**px4: float) -> Autopilot:
    return Autopilot(
        commander=Commander(check_period_s=0.02, loss_latency_s=0.3, proof_of_life_s=0.2),
        estimator=Estimator(bandwidth_rad_s=12.0, gate_m=0.2, rejection_s=1.5, dead_reckoning_s=4.7, delay_max_s=0.2),
        cascade=load_vehicle("light").cascade,
        idle_thrust=0.1,
        landed_thrust=0.5,
        landed_after_s=1.0,
        landed_speed_mps=0.2,
        risen_m=0.1,
        px4={**PX4, **px4},
    )


def at(p_W: Array) -> Setpoint:
    """Be at `p_W`, at rest, heading along x."""
    return Setpoint(np.asarray(p_W, dtype=float), np.zeros(3), np.zeros(3), np.array(0.0))


class Standin:
    """One vehicle on the floor; `mocap_offset_W` shifts what motion capture says, None hides the vehicle.

    What it says is `mocap_late_steps` old, which it does not say.
    """

    def __init__(self, p: Autopilot | None = None) -> None:
        self.p = p or parameters()
        self.body = load_vehicle("light").quadrotor
        self.robot = quadrotor.at_rest(np.array([0.0, 0.0, self.body.gear_height_m]), self.body)
        self.state = autopilot.initial(self.robot.p_W, self.robot.q_WB_wxyz, self.p)
        self.sensors = Sensors(np.array([0.0, 0.0, GRAVITY_MPS2]), np.zeros(3), self.robot.q_WB_wxyz)
        self.mocap_offset_W: Array | None = np.zeros(3)
        self.mocap_late_steps = 0
        self._been = (self.robot.p_W,)
        self.target: Setpoint | None = None
        self.texts: list[str] = []
        self._ticks = 0

    @property
    def mode(self) -> Mode:
        return self.state.commander.mode

    @property
    def armed(self) -> bool:
        return self.state.commander.armed

    def step(self, inputs: list[Input]) -> Output:
        """4 ms of autopilot and physics."""
        self.state, output = autopilot.step(self.state, self.sensors, inputs, STEP_S, self.p)
        before = self.robot.v_W
        for _ in range(2):
            self.robot = quadrotor.step(self.robot, output.motors, np.zeros(3), STEP_S / 2, self.body)
        felt_W = (self.robot.v_W - before) / STEP_S + [
            0.0,
            0.0,
            GRAVITY_MPS2,
        ]  # the mean over the step: the touch-down too
        felt_B = felt_W @ rotation_matrix(self.robot.q_WB_wxyz)
        self.sensors = Sensors(felt_B, self.robot.omega_B, self.robot.q_WB_wxyz)
        self._been = (*self._been, self.robot.p_W)[-1 - self.mocap_late_steps :]
        self.texts += output.texts
        self._ticks += 1
        return output

    def poses(self) -> list[Input]:
        """Motion capture at 62.5 Hz."""
        if self.mocap_offset_W is None or self._ticks % 4:
            return []
        return [Pose(self._been[0] + self.mocap_offset_W)]

    def ask(self, request: Request) -> Ack:
        """One step with a request in it, and the answer."""
        answers: tuple[Answer, ...] = self.step([*self.poses(), *self._stream(), request]).answers
        assert answers[0].request is request
        return answers[0].ack

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> float:
        """Fly until something is so, at most `seconds`; the time it took."""
        for n in range(round(seconds / STEP_S)):
            if until():
                return n * STEP_S
            self.step([*self.poses(), *self._stream()])
        return seconds

    def take_off(self, p_W: Array = ABOVE) -> None:
        """In offboard at `p_W`, settled."""
        self.target = at(p_W)
        self.run(0.5)
        assert self.ask(Switch(Mode.OFFBOARD)) is Ack.ACCEPTED
        assert self.ask(Arm(True)) is Ack.ACCEPTED
        self.run(8.0)

    def _stream(self) -> list[Input]:
        """Set-points at 83 Hz, while there are any."""
        return [Target(self.target)] if self.target is not None and self._ticks % 3 == 0 else []
