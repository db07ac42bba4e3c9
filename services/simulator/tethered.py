"""The robot of an experiment without a bus: observer, admittance filter and set-point round a PX4-like vehicle.

| paper | here | unit | frame |
|---|---|---|---|
| f̂_c, on the handle | State.f_c | N | W |
| p_R, v_R of the filter (the reference) | State.reference | m, m/s | W |
| p_R, v_R of the vehicle | State.flight.robot | m, m/s | W |
| M_A, m_R, ... | Robot.filter, Robot.observer, Robot.vehicle | | |

These are the bridge's and the estimator's own laws, wired as those services wire them in flight (feed-forward fully ramped
in, no take-off, no bias to be tared, the guidance as `command`). Each parameter may be a number or, for a batch, an array
(...). One round of 4 ms is one `tick`, then `flight.SUBSTEPS` times `move`, with the cable's force made anew for each.
"""

import math
from typing import NamedTuple

import numpy as np

from services.force_estimator import observer
from services.force_estimator.observer import Observer
from services.physics import Array, Scalar
from services.px4_bridge import admittance, setpoint
from services.px4_bridge.admittance import Admittance, Command
from services.simulator import flight, imu, quadrotor
from services.simulator.cascade import Setpoint
from services.simulator.flight import TICK_S, Latency, Vehicle


class Robot(NamedTuple):
    """The vehicle and the laws that fly it; no reference rises above `z_max_m`."""

    vehicle: Vehicle
    filter: Admittance
    observer: Observer
    latency: Latency = Latency()
    z_max_m: float = math.inf
    lead_s: Scalar = 0.0


class State(NamedTuple):
    """Vehicle, filter, observer, and f̂_c (..., 3) as the observer last put it."""

    flight: flight.State
    reference: admittance.State
    seen: observer.State
    f_c: Array


def hovering(p_R: Array, f_c: Array, p: Robot) -> State:
    """At rest at `p_R` (..., 3) with the cable force `f_c` (..., 3) already seen."""
    f_c = np.broadcast_to(f_c, p_R.shape)
    return State(flight.hovering(p_R, p.vehicle), admittance.engage(p_R), observer.State(-f_c), f_c)


def tick(state: State, f_ext_W: Array, command: Command, slack: Scalar, normal: Array, p: Robot) -> State:
    """One sample of the inertial unit through observer, filter and autopilot.

    `f_ext_W` (..., 3) N is felt now; `normal` (..., 3) are the standard normal numbers of the accelerometer's noise.
    """
    robot, body = state.flight.robot, p.vehicle.quadrotor
    a_B = imu.accelerometer(quadrotor.specific_force_B(robot, f_ext_W, body), normal, TICK_S, p.vehicle.imu)
    thrust = robot.rotor_thrust_N.sum(-1)
    seen, f_c = observer.step(state.seen, a_B, robot.q_WB_wxyz, thrust, TICK_S, p.observer)
    reference, _ = admittance.step(state.reference, f_c, command, slack, TICK_S, p.z_max_m, p.filter)
    b = admittance.damping(reference, command, p.filter)
    a_sp = setpoint.ahead(reference, b, p.filter.M_A_kg, p.lead_s).a + f_c / body.mass_kg
    heading = np.zeros(f_c.shape[:-1])
    steered = flight.steer(state.flight, Setpoint(reference.p, reference.v, a_sp, heading), p.vehicle, p.latency)
    return State(steered, reference, seen, f_c)


def move(state: State, f_ext_W: Array, p: Robot) -> State:
    """A millisecond of physics under `f_ext_W` (..., 3) N."""
    return state._replace(flight=flight.move(state.flight, f_ext_W, p.vehicle))
