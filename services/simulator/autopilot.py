"""A PX4-like autopilot without sockets: estimator, commander and cascade in one step.

| input | here | unit | frame |
|---|---|---|---|
| accelerometer, gyro, attitude | Sensors, noise already in them | m/s², rad/s, - | B |
| what came over MAVLink since the last step | Pose, Target and the commander's requests | | W |
| PX4 parameters by their own names | px4 | as in PX4 | |

`step` runs at 250 Hz, which is the rate of PX4's inertial stream; the cascade halves it for its position loop. The
attitude is the truth plus the caller's noise (estimator.py). Set-points come in the world frame; the border
translates.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from services.parameters import Fraction, NonNegative, Positive, parameters
from services.physics import yaw_from
from services.simulator import cascade, commander, estimator
from services.simulator.cascade import Cascade, CascadeState, Estimate, Setpoint
from services.simulator.commander import Ack, Commander, CommanderState, Mode, Request, SetParameter, Situation
from services.simulator.estimator import Estimator, EstimatorState

Array = NDArray[np.float64]

STEP_S = 0.004
_REQUIRED = (*commander.PARAMETERS, "MPC_LAND_SPEED")
_NAN3 = np.full(3, np.nan)


@parameters
class Autopilot:
    """All of the stand-in. `px4` holds parameters under PX4's names; integers there are integers on the wire."""

    commander: Commander
    estimator: Estimator
    cascade: Cascade
    idle_thrust: Fraction
    landed_thrust: Fraction
    """Of the hover thrust: below it, and still, the vehicle is on the ground."""
    landed_after_s: Positive
    landed_speed_mps: Positive
    risen_m: NonNegative
    """How far above the place where it stood it counts as flying."""
    px4: dict[str, int | float]


class Sensors(NamedTuple):
    """specific_force_B, omega_B (3,), q_WB_wxyz (4,), the battery, and the height above the floor by the barometer."""

    specific_force_B: Array
    omega_B: Array
    q_WB_wxyz: Array
    battery_fraction: float = 1.0
    height_m: float = 0.0


class Pose(NamedTuple):
    """A motion-capture position that has just arrived, (3,) m, and its age; the attitude that comes with it is not used."""

    p_W: Array
    age_s: float = 0.0


class Target(NamedTuple):
    """A set-point that has just arrived; components that are not set are NaN."""

    setpoint: Setpoint


Input: TypeAlias = Pose | Target | Request


class Ground(NamedTuple):
    """The land detector: whether it stands, for how long it looked like it, and the height at which it stood."""

    landed: bool
    still_s: float
    height_m: float


class AutopilotState(NamedTuple):
    """`entered` is the pose at which the present mode began: p_W (3,) and yaw."""

    t_s: float
    estimator: EstimatorState
    commander: CommanderState
    control: CascadeState
    ground: Ground
    offboard: Setpoint
    entered: Setpoint
    setpoint: Setpoint  # what the cascade is told now
    estimate: Estimate
    has_position: bool
    motors: Array
    px4: Mapping[str, int | float]
    cascade: Cascade  # as the parameters have changed it


class Answer(NamedTuple):
    """The autopilot's word on a request."""

    request: Request
    ack: Ack


class Output(NamedTuple):
    """Motor commands (4,) in 0..1; answers and remarks to be sent once."""

    motors: Array
    answers: tuple[Answer, ...]
    texts: tuple[str, ...]


class Link(Protocol):
    """How the autopilot reaches its companion: MAVLink, or in process."""

    def receive(self) -> list[Input]:
        """What has arrived since the last call."""
        ...

    def send(self, state: AutopilotState, sensors: Sensors, output: Output) -> None:
        """Send what is due after a step."""
        ...


def initial(p_W: Array, q_WB_wxyz: Array, p: Autopilot) -> AutopilotState:
    """Disarmed on the ground at `p_W`. Raises ValueError when a PX4 parameter that is used here is missing."""
    missing = [name for name in _REQUIRED if name not in p.px4]
    if missing:
        raise ValueError(f"autopilot.px4: {', '.join(missing)} missing; the stand-in needs {', '.join(_REQUIRED)}")
    estimate = Estimate(p_W.astype(float), np.zeros(3), q_WB_wxyz, np.zeros(3))
    gains = _retuned(p.cascade, p.px4)
    here = Setpoint(estimate.p_W, np.zeros(3), _NAN3, yaw_from(q_WB_wxyz))
    return AutopilotState(
        t_s=0.0,
        estimator=estimator.initial(p_W),
        commander=CommanderState(),
        control=cascade.initial(estimate, gains),
        ground=Ground(True, 0.0, float(p_W[2])),
        offboard=here,
        entered=here,
        setpoint=here,
        estimate=estimate,
        has_position=False,
        motors=np.zeros(4),
        px4=dict(p.px4),
        cascade=gains,
    )


def step(
    state: AutopilotState, sensors: Sensors, inputs: Sequence[Input], dt: float, p: Autopilot
) -> tuple[AutopilotState, Output]:
    """One tick of `dt` (4 ms) with everything that arrived since the last one."""
    before = state.commander
    state = _sensed(state, sensors, dt, p)
    state, answers = _heard(state, inputs, p)
    now = _situation(state, p)
    orders, texts = commander.step(state.commander, now, dt, state.px4, p.commander)
    state = state._replace(t_s=state.t_s + dt, commander=orders, has_position=now.has_position)
    if orders.mode is not before.mode or orders.armed is not before.armed:
        state = state._replace(entered=Setpoint(state.estimate.p_W, np.zeros(3), _NAN3, state.setpoint.yaw_rad))
    state = _land_detected(_flown(state, dt, p), dt, p)
    return state, Output(state.motors, answers, texts)


def _situation(state: AutopilotState, p: Autopilot) -> Situation:
    return Situation(state.ground.landed, estimator.is_valid(state.estimator, p.estimator))


def _sensed(state: AutopilotState, sensors: Sensors, dt: float, p: Autopilot) -> AutopilotState:
    resting = state.ground.landed and not state.commander.armed
    moved = estimator.propagate(state.estimator, sensors.specific_force_B, sensors.q_WB_wxyz, dt, resting=resting)
    return _estimated(state, moved, sensors)


def _estimated(state: AutopilotState, belief: EstimatorState, sensors: Sensors) -> AutopilotState:
    estimate = Estimate(belief.p_W, belief.v_W, sensors.q_WB_wxyz, sensors.omega_B)
    return state._replace(estimator=belief, estimate=estimate)


def _heard(state: AutopilotState, inputs: Sequence[Input], p: Autopilot) -> tuple[AutopilotState, tuple[Answer, ...]]:
    answers: list[Answer] = []
    for item in inputs:
        match item:
            case Pose(p_W=p_W, age_s=age_s):
                late_s = age_s + 1e-3 * state.px4.get("EKF2_EV_DELAY", 0.0)
                belief = estimator.correct(state.estimator, p_W, p.estimator, late_s)
                estimate = state.estimate._replace(p_W=belief.p_W, v_W=belief.v_W)
                state = state._replace(estimator=belief, estimate=estimate)
            case Target(setpoint=setpoint):
                orders = commander.heard_setpoint(state.commander)
                state = state._replace(offboard=setpoint, commander=orders)
            case _:
                state, ack = _answered(state, item, p)
                answers.append(Answer(item, ack))
    return state, tuple(answers)


def _answered(state: AutopilotState, request: Request, p: Autopilot) -> tuple[AutopilotState, Ack]:
    if isinstance(request, SetParameter):
        return _set_parameter(state, request, p)
    orders, ack = commander.answer(state.commander, request, _situation(state, p), state.px4, p.commander)
    if orders.armed and not state.commander.armed:
        fresh = cascade.initial(state.estimate, state.cascade)
        state = state._replace(control=fresh)
    return state._replace(commander=orders), ack


def _set_parameter(state: AutopilotState, request: SetParameter, p: Autopilot) -> tuple[AutopilotState, Ack]:
    """A parameter keeps its type; PX4 does not change one that it does not have."""
    if request.name not in state.px4:
        return state, Ack.DENIED
    kind = type(state.px4[request.name])
    px4 = {**state.px4, request.name: kind(request.value)}
    return state._replace(px4=px4, cascade=_retuned(p.cascade, px4)), Ack.ACCEPTED


def _retuned(gains: Cascade, px4: Mapping[str, int | float]) -> Cascade:
    """The one parameter of the cascade that tethered flight changes (G5b)."""
    return replace(gains, acc_decouple=bool(px4.get("MPC_ACC_DECOUPLE", gains.acc_decouple)))


def _flown(state: AutopilotState, dt: float, p: Autopilot) -> AutopilotState:
    """Motors for the mode that flies; nothing winds up on the ground."""
    if not state.commander.armed or state.commander.stopped:
        return state._replace(motors=np.zeros(4))
    setpoint = _setpoint(state)
    control = cascade.without_integrals(state.control) if state.ground.landed else state.control
    control, motors = cascade.step(control, state.estimate, setpoint, dt, state.cascade)
    if state.ground.landed and state.commander.mode is not Mode.OFFBOARD:
        motors = np.full(4, p.idle_thrust)
    return state._replace(setpoint=setpoint, control=control, motors=motors)


def _setpoint(state: AutopilotState) -> Setpoint:
    """Offboard obeys; Hold stays; Land goes straight down; Descend only knows its sinking speed, level."""
    speed, here = state.px4["MPC_LAND_SPEED"], state.entered
    match state.commander.mode:
        case Mode.OFFBOARD:
            return state.offboard
        case Mode.HOLD:
            return here
        case Mode.LAND:
            return Setpoint(here.p_W * [1.0, 1.0, np.nan], np.array([0.0, 0.0, -speed]), _NAN3, here.yaw_rad)
        case Mode.DESCEND:
            down = np.array([np.nan, np.nan, -speed])
            return Setpoint(_NAN3, down, np.array([0.0, 0.0, np.nan]), here.yaw_rad)


def _land_detected(state: AutopilotState, dt: float, p: Autopilot) -> AutopilotState:
    """On the ground when still at low thrust for a while; flying when it has risen from there."""
    ground, height = state.ground, float(state.estimate.p_W[2])
    if not state.commander.armed:
        near = ground.landed
        return state._replace(ground=Ground(True, 0.0, height) if near else _stillness(state, dt, p))
    if ground.landed:
        return state._replace(ground=ground._replace(landed=height < ground.height_m + p.risen_m, still_s=0.0))
    return state._replace(ground=_stillness(state, dt, p))


def _stillness(state: AutopilotState, dt: float, p: Autopilot) -> Ground:
    v_W = state.estimate.v_W
    low = float(state.motors.sum()) < 4.0 * p.landed_thrust * state.cascade.hover_thrust
    still = low and float(v_W @ v_W) < p.landed_speed_mps**2
    still_s = state.ground.still_s + dt if still else 0.0
    return Ground(still_s >= p.landed_after_s, still_s, float(state.estimate.p_W[2]))
