"""The world in real time: vehicle, cable, handle, person, and the stand-in autopilot that flies them over MAVLink.

It says what the capture system sees and, for reports, the truth. It listens to the supervisor only as the simulated person
listens to the experimenter: to be told when to take the handle and when to let go.
"""

import numpy as np

from schemas.safety import Phase, SafetyState
from schemas.simulation import Truth
from schemas.topics import MOCAP_FRAME, SAFETY_STATE, TRUTH
from schemas.tracking import MocapFrame
from services.config import Config
from services.physics import GRAVITY_MPS2, Array, Z, conjugate, rotate
from services.runtime.node import Node
from services.runtime.pace import Pace
from services.runtime.readers import Latest
from services.simulator import autopilot, imu, world
from services.simulator.autopilot import STEP_S, Autopilot, AutopilotState, Link, Sensors
from services.simulator.mavlink import MavlinkLink
from services.simulator.world import Told, WorldParams, WorldState

PHYSICS_STEPS = 4  # of 1 ms in each step of the autopilot
_LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
SILENCE_SEEN_S = 1.5
CATCH_UP_S = 0.1
"""After a stall of the host the world goes on by at most this much: what it did in between was not calculated."""


async def run(node: Node, config: Config) -> None:
    """Play the vehicle on the profile's MAVLink address."""
    host, port = config.simulator.companion.rsplit(":", 1)
    with MavlinkLink((host, int(port))) as link:
        await play(node, config, link)


async def play(node: Node, config: Config, link: Link) -> None:
    """The world's loop at the autopilot's 250 Hz."""
    stage = Stage(config)
    frames, truths = node.publisher(MOCAP_FRAME), node.publisher(TRUTH)
    safety = node.latest(SAFETY_STATE)
    frame_pace, truth_pace = Pace(config.simulator.mocap_rate_Hz), Pace(TRUTH.rate_Hz)
    async for tick in node.ticks(1.0 / STEP_S):
        steps = round(min(tick.dt_s, CATCH_UP_S) / STEP_S)
        for left in reversed(range(steps)):  # a late turn makes up for what it missed, each sample at its own time
            stage.step(_told(safety), link)
            now_ns = tick.stamp_ns - left * round(1e9 * STEP_S)
            if frame_pace.due(now_ns):
                frames.publish(stage.capture().model_copy(update={"stamp_ns": now_ns}))
            if truth_pace.due(now_ns):
                truths.publish(stage.truth().model_copy(update={"stamp_ns": now_ns}))
        node.status = f"subject {stage.world.subject.phase.value}"


def _told(safety: Latest[SafetyState]) -> Told:
    """What the experimenter says, who watches the supervisor's phase, and knows what to say when it falls silent."""
    phase = safety.message.phase if safety.message else Phase.IDLE
    if safety.message and safety.age_s > SILENCE_SEEN_S:
        return Told(let_go=True)
    return Told(
        take=phase in (Phase.READY, Phase.GUIDING),
        let_go=phase in (Phase.CLEARING, Phase.LANDING, Phase.LANDED, Phase.KILLED),
    )


class Stage:
    """World and autopilot together, and the seeded noise of their sensors."""

    def __init__(self, config: Config) -> None:
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
        self.world = self._initial()
        self._autopilot: Autopilot = config.simulator.autopilot
        robot = self.world.robot
        self._v_before = robot.v_W
        self._pilot: AutopilotState = autopilot.initial(robot.p_W, robot.q_WB_wxyz, self._autopilot)

    def step(self, told: Told, link: Link) -> None:
        """One step of the autopilot, then the physics under its motors."""
        sensors = self._sense()
        self._pilot, output = autopilot.step(self._pilot, sensors, link.receive(), STEP_S, self._autopilot)
        link.send(self._pilot, sensors, output)
        self._v_before = self.world.robot.v_W
        for _ in range(PHYSICS_STEPS):
            self.world = world.step(self.world, output.motors, told, STEP_S / PHYSICS_STEPS, self.params)

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

    def _sense(self) -> Sensors:
        """What the inertial unit makes of the last step: the mean specific force, so that a touch-down is felt."""
        robot, p = self.world.robot, self.config.vehicle.imu
        felt_W = (robot.v_W - self._v_before) / STEP_S + GRAVITY_MPS2 * Z
        normal = self._noise.standard_normal((2, 3))
        return Sensors(
            imu.accelerometer(rotate(conjugate(robot.q_WB_wxyz), felt_W), normal[0], STEP_S, p),
            imu.gyroscope(robot.omega_B, normal[1], STEP_S, p),
            robot.q_WB_wxyz,
        )


# Messages are validated in one go from plain numbers, which costs half as much as making their parts one by one.


def _body(p_W: Array, q_WB_wxyz: Array) -> dict[str, object]:
    return {"tracked": True, "position_m": _xyz(p_W), "q_WB_wxyz": _wxyz(q_WB_wxyz)}


def _xyz(v: Array) -> dict[str, float]:
    return dict(zip("xyz", v.tolist(), strict=True))


def _wxyz(q: Array) -> dict[str, float]:
    return dict(zip("wxyz", q.tolist(), strict=True))
