"""A vehicle with PX4-like control in the air, or many at once: the cascade flies the rigid body through latencies.

| here | meaning | unit |
|---|---|---|
| Vehicle | deploy/vehicles/*.toml: the body, its autopilot's gains, its inertial sensor | |
| Latency | from the truth to the control's estimate, and from a set-point to its use | ticks of TICK_S |
| f_ext_W | what pulls at the vehicle from outside (the cable: -f_c) | N, W |

Control and physics are two steps, so that whoever pulls can be simulated between them: `steer` every TICK_S, then `move`
SUBSTEPS times. `autopilot.py` is the same vehicle with modes, an estimator and a floor, for one at a time; this is for
maps and campaigns. Everything broadcasts over leading axes; latencies may be arrays (...) too.
"""

from typing import NamedTuple, TypeVar

import numpy as np

from services.parameters import parameters
from services.physics import Array, Scalar
from services.simulator import cascade, quadrotor
from services.simulator.cascade import Cascade, CascadeState, Estimate, Setpoint
from services.simulator.imu import Imu
from services.simulator.quadrotor import Quadrotor, QuadrotorState

TICK_S = 0.004
SUBSTEPS = 4

T = TypeVar("T", Estimate, Setpoint)


@parameters
class Vehicle:
    """The body, the autopilot's control gains, the inertial sensor."""

    quadrotor: Quadrotor
    cascade: Cascade
    imu: Imu


class Latency(NamedTuple):
    """Whole ticks of 4 ms, an int or an array (...) of them; two each way are a companion computer beside PX4."""

    estimate: Scalar = 2
    setpoint: Scalar = 2


class State(NamedTuple):
    """Body, control, the motors' thrust fractions (..., 4), and what is still on its way, newest last."""

    robot: QuadrotorState
    control: CascadeState
    motors: Array
    estimates: tuple[Estimate, ...]
    setpoints: tuple[Setpoint, ...]


def hovering(p_W: Array, vehicle: Vehicle, offset_W: Array | float = 0.0) -> State:
    """Level and still at `p_W` (..., 3); `offset_W` is what the position estimate is wrong by, m."""
    robot = quadrotor.at_rest(p_W, vehicle.quadrotor, hovering=True)
    believed = _believed(robot, offset_W)
    motors = np.full((*p_W.shape[:-1], 4), vehicle.cascade.hover_thrust)
    return State(robot, cascade.initial(believed, vehicle.cascade), motors, (believed,), ())


def steer(state: State, setpoint: Setpoint, vehicle: Vehicle, latency: Latency, offset_W: Array | float = 0.0) -> State:
    """One tick of control on what has arrived by now of estimates and set-points; the motors hold until the next."""
    estimates = _kept(state.estimates, _believed(state.robot, offset_W), latency.estimate)
    setpoints = _kept(state.setpoints, setpoint, latency.setpoint)
    estimate, used = _late(estimates, latency.estimate), _late(setpoints, latency.setpoint)
    control, motors = cascade.step(state.control, estimate, used, TICK_S, vehicle.cascade)
    return State(state.robot, control, motors, estimates, setpoints)


def move(state: State, f_ext_W: Array, vehicle: Vehicle) -> State:
    """The body's next TICK_S / SUBSTEPS seconds under `f_ext_W` (..., 3) N."""
    robot = quadrotor.step(state.robot, state.motors, f_ext_W, TICK_S / SUBSTEPS, vehicle.quadrotor)
    return state._replace(robot=robot)


def _believed(robot: QuadrotorState, offset_W: Array | float) -> Estimate:
    return Estimate(robot.p_W + offset_W, robot.v_W, robot.q_WB_wxyz, robot.omega_B)


def _kept(history: tuple[T, ...], newest: T, ticks: Scalar) -> tuple[T, ...]:
    """As much of the past as the longest latency needs."""
    return (*history, newest)[-1 - int(np.max(ticks)) :]


def _late(history: tuple[T, ...], ticks: Scalar) -> T:
    """What was the newest `ticks` ago, or the first there is; vehicles with latencies of their own get each its own."""
    if not np.ndim(ticks):
        return history[-1 - min(int(ticks), len(history) - 1)]
    chosen = history[-1]
    for late in np.unique(ticks):
        old = _late(history, late)
        chosen = type(chosen)(*(_where(ticks == late, a, b) for a, b in zip(old, chosen, strict=True)))
    return chosen


def _where(flag: Array, if_so: Array, if_not: Array) -> Array:
    """By vehicle, whatever axes follow."""
    return np.where(flag.reshape(flag.shape + (1,) * (np.ndim(if_so) - flag.ndim)), if_so, if_not)
