"""The stand-in for PX4's multicopter control: position, velocity, attitude and rate loops, and the mixer.

| PX4 | here | unit | frame |
|---|---|---|---|
| set-point, unset components NaN | p_sp_W, v_sp_W, a_sp_W, yaw_sp | m, m/s, m/s², rad | W |
| estimate | p_W, v_W, q_WB_wxyz, omega_B | m, m/s, -, rad/s | W, B |
| MPC_XY_P, MPC_XY_VEL_P_ACC, ... | gains of the same meaning in `Cascade` | | |
| MPC_THR_HOVER | hover_thrust, of all motors at full thrust | - | |

PX4 works in NED/FRD; this law works in the project's z-up world and forward-left-up body, which only turns signs. The attitude
and rate loops run at every call (250 Hz), the position loop at every second one (125 Hz). Like PX4's, the law assumes that the
hover thrust carries 1 g exactly; a hover thrust estimate (MPC_USE_HTE) is not modelled. Latencies belong to the harness.

Why not PX4 itself: this runs in a test, on a virtual clock, for many vehicles at once (G2, G5). Everything broadcasts.
"""

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from services.parameters import Fraction, NonNegative, Positive, parameters
from services.physics import (
    GRAVITY_MPS2,
    Array,
    Components,
    Scalar,
    anywhere,
    at_least,
    choose,
    clamp,
    components,
    scalar,
    vector,
    yaw_from,
)
from services.simulator.attitude import attitude_error, limit_tilt, limit_xy, mix

POSITION_LOOP_DIVIDER = 2  # position and velocity loop run at every second call
_FADING_RATE_RAD_S = math.radians(400.0)  # PX4 fades the rate integrator out towards this error


@parameters
class Cascade:
    """Gains and limits, named after PX4's parameters; angles in degrees as there."""

    hover_thrust: Fraction
    thr_min: Fraction
    thr_max: Fraction
    thr_xy_margin: Fraction
    tilt_max_deg: Positive
    acc_decouple: bool
    xy_p_per_s: Positive
    z_p_per_s: Positive
    xy_vel_p_per_s: Positive
    xy_vel_i_per_s2: NonNegative
    xy_vel_d: NonNegative
    z_vel_p_per_s: Positive
    z_vel_i_per_s2: NonNegative
    z_vel_d: NonNegative
    velocity_derivative_cutoff_Hz: Positive
    xy_vel_max_mps: Positive
    z_vel_max_up_mps: Positive
    z_vel_max_down_mps: Positive
    roll_pitch_p_per_s: Positive
    yaw_p_per_s: Positive
    yaw_weight: Fraction
    roll_pitch_rate_max_deg_s: Positive
    yaw_rate_max_deg_s: Positive
    roll_pitch_rate_p_s: Positive
    roll_pitch_rate_i: NonNegative
    roll_pitch_rate_d_s2: NonNegative
    yaw_rate_p_s: Positive
    yaw_rate_i: NonNegative
    rate_integral_max: NonNegative
    gyro_cutoff_Hz: Positive
    gyro_derivative_cutoff_Hz: Positive


class Estimate(NamedTuple):
    """What the vehicle believes: p_W, v_W, omega_B (..., 3), q_WB_wxyz (..., 4)."""

    p_W: Array
    v_W: Array
    q_WB_wxyz: Array
    omega_B: Array


class Setpoint(NamedTuple):
    """What it is told: three (..., 3) and a yaw (...,); a NaN component is not set and has no influence.

    An axis with nothing set at all is told to stop, as PX4 does when it refuses a set-point.
    """

    p_W: Array
    v_W: Array
    a_W: Array
    yaw_rad: Scalar


class CascadeState(NamedTuple):
    """Integrators and filters, and what the slow loop left for the fast one: thrust direction and size, heading."""

    tick: int
    velocity_integral: Array
    velocity: Array
    acceleration: Array  # filtered derivative of the estimated velocity
    thrust_direction_W: Array
    thrust: Scalar
    yaw_rad: Scalar
    rate: Array  # filtered gyro
    angular_acceleration: Array
    rate_integral: Array


class _Arrays(NamedTuple):
    """The parameters as vectors, and the filters' gains, for one step length."""

    p: Array
    vel_p: Array
    vel_i: Array
    vel_d: Array
    integral_max: Array
    att_p: Array
    rate_max: Array
    rate_p: Array
    rate_i: Array
    rate_d: Array
    velocity_gain: float
    gyro_gain: float
    derivative_gain: float


@cache
def _arrays(p: Cascade, dt: float) -> _Arrays:
    yaw_p = p.yaw_p_per_s / max(p.yaw_weight, 1e-4)  # PX4 undoes the weight's shortening of the error
    rate_max = np.radians([p.roll_pitch_rate_max_deg_s, p.roll_pitch_rate_max_deg_s, p.yaw_rate_max_deg_s])
    return _Arrays(
        p=np.array([p.xy_p_per_s, p.xy_p_per_s, p.z_p_per_s]),
        vel_p=np.array([p.xy_vel_p_per_s, p.xy_vel_p_per_s, p.z_vel_p_per_s]),
        vel_i=np.array([p.xy_vel_i_per_s2, p.xy_vel_i_per_s2, p.z_vel_i_per_s2]),
        vel_d=np.array([p.xy_vel_d, p.xy_vel_d, p.z_vel_d]),
        integral_max=np.array([np.inf, np.inf, GRAVITY_MPS2]),
        att_p=np.array([p.roll_pitch_p_per_s, p.roll_pitch_p_per_s, yaw_p]),
        rate_max=rate_max,
        rate_p=np.array([p.roll_pitch_rate_p_s, p.roll_pitch_rate_p_s, p.yaw_rate_p_s]),
        rate_i=np.array([p.roll_pitch_rate_i, p.roll_pitch_rate_i, p.yaw_rate_i]),
        rate_d=np.array([p.roll_pitch_rate_d_s2, p.roll_pitch_rate_d_s2, 0.0]),
        velocity_gain=_low_pass(p.velocity_derivative_cutoff_Hz, POSITION_LOOP_DIVIDER * dt),
        gyro_gain=_low_pass(p.gyro_cutoff_Hz, dt),
        derivative_gain=_low_pass(p.gyro_derivative_cutoff_Hz, dt),
    )


def _low_pass(cutoff_Hz: float, dt: float) -> float:
    return -math.expm1(-2 * math.pi * cutoff_Hz * dt)


def initial(estimate: Estimate, p: Cascade) -> CascadeState:
    """Integrators empty, level, at hover thrust, at the present heading."""
    zero = np.zeros_like(estimate.p_W)
    yaw = yaw_from(estimate.q_WB_wxyz)
    up, thrust = zero + [0.0, 0.0, 1.0], p.hover_thrust + 0.0 * yaw
    return CascadeState(0, zero, estimate.v_W, zero, up, thrust, yaw, estimate.omega_B, zero, zero)


def without_integrals(state: CascadeState) -> CascadeState:
    """What PX4 does while the vehicle stands on the ground: nothing winds up."""
    zero = np.zeros_like(state.velocity_integral)
    return state._replace(velocity_integral=zero, rate_integral=zero)


def step(
    state: CascadeState, estimate: Estimate, setpoint: Setpoint, dt: float, p: Cascade
) -> tuple[CascadeState, Array]:
    """One tick of `dt` (4 ms): the motors' thrust fractions, (..., 4) in 0..1, in the order of quadrotor.py."""
    k = _arrays(p, dt)
    if state.tick % POSITION_LOOP_DIVIDER == 0:
        state = _position_loop(state, estimate, setpoint, POSITION_LOOP_DIVIDER * dt, p, k)
    state, torque = _rate_loop(state, estimate, _rate_setpoint(state, estimate, p, k), dt, p, k)
    return state._replace(tick=state.tick + 1), mix(state.thrust, torque)


def _unset(x: Scalar) -> Scalar:
    """Whether it is NaN, which is what does not equal itself."""
    return x != x


def _add(a: Scalar, b: Scalar) -> Scalar:
    """a + b where both are set, else whichever is."""
    return choose(_unset(a), b, choose(_unset(b), a, a + b))


def _position_loop(
    state: CascadeState, estimate: Estimate, setpoint: Setpoint, dt: float, p: Cascade, k: _Arrays
) -> CascadeState:
    error = vector(*_velocity_setpoint(estimate, setpoint, p, k)) - estimate.v_W
    slope = (estimate.v_W - state.velocity) / dt
    acceleration = state.acceleration + k.velocity_gain * (slope - state.acceleration)
    feedback = k.vel_p * error + state.velocity_integral - k.vel_d * acceleration
    a_sp = vector(*map(_add, components(setpoint.a_W), components(feedback)))
    direction, thrust = _saturate(*thrust_vector(a_sp, p), p)
    correction = _unwound(components(error), components(a_sp), components(direction), thrust, p)
    integral = state.velocity_integral + dt * k.vel_i * vector(*correction)
    yaw = scalar(setpoint.yaw_rad)
    return state._replace(
        velocity_integral=np.minimum(np.maximum(integral, -k.integral_max), k.integral_max),
        velocity=estimate.v_W,
        acceleration=acceleration,
        thrust_direction_W=direction,
        thrust=thrust,
        yaw_rad=choose(_unset(yaw), yaw_from(estimate.q_WB_wxyz), yaw),
    )


def _velocity_setpoint(estimate: Estimate, setpoint: Setpoint, p: Cascade, k: _Arrays) -> Components:
    """Position P plus velocity feed-forward, limited; three, NaN where neither is set but an acceleration is."""
    correction = components(k.p * (setpoint.p_W - estimate.p_W))
    v_sp = map(_add, components(setpoint.v_W), correction)
    x, y, z = (choose(_unset(v) & _unset(a), 0.0, v) for v, a in zip(v_sp, components(setpoint.a_W), strict=True))
    too_fast = x * x + y * y > p.xy_vel_max_mps**2
    if anywhere(too_fast):
        first = [choose(_unset(c), 0.0, c) for c in correction[:2]]
        limited = limit_xy(first, (x, y), p.xy_vel_max_mps)
        x, y = choose(too_fast, limited[0], x), choose(too_fast, limited[1], y)
    return x, y, clamp(z, -p.z_vel_max_down_mps, p.z_vel_max_up_mps)


def thrust_vector(a_sp_W: Array, p: Cascade) -> tuple[Array, Scalar]:
    """Thrust direction (..., 3) and size (...,) for an acceleration, PX4's `_accelerationControl`.

    Decoupled (MPC_ACC_DECOUPLE = 1, PX4's default) the tilt is set as if the vertical specific force were g; coupled, as
    tethered flight wants it (G5b), as if it were what the vertical set-point asks for.
    """
    a_x, a_y, a_z = components(a_sp_W)
    up = GRAVITY_MPS2 if p.acc_decouple else GRAVITY_MPS2 + a_z
    size = at_least((a_x * a_x + a_y * a_y + up * up) ** 0.5, 1e-9)
    x, y, z = limit_tilt(a_x / size, a_y / size, up / size, math.cos(math.radians(p.tilt_max_deg)))
    vertical = p.hover_thrust * (1.0 + a_z / GRAVITY_MPS2)
    return vector(x, y, z), at_least(vertical / z, p.thr_min)


def _saturate(direction: Array, thrust: Scalar, p: Cascade) -> tuple[Array, Scalar]:
    """Too much thrust: height first, but a margin is kept for the horizontal part."""
    if not anywhere(thrust > math.sqrt(p.thr_max**2 - p.thr_xy_margin**2)):
        return direction, thrust
    x, y, z = (thrust * axis for axis in components(direction))
    flat = (x * x + y * y) ** 0.5
    margin = clamp(flat, 0.0, p.thr_xy_margin)
    up = clamp(z, 0.0, (p.thr_max**2 - margin * margin) ** 0.5)
    room = at_least(p.thr_max**2 - up * up, 0.0) ** 0.5
    sideways = clamp(room / at_least(flat, 1e-9), 0.0, 1.0)
    size = ((x * x + y * y) * sideways * sideways + up * up) ** 0.5
    return vector(x * sideways / size, y * sideways / size, up / size), size


def _unwound(error: Components, a_sp: Components, direction: Components, thrust: Scalar, p: Cascade) -> Components:
    """The velocity error that is integrated, with PX4's anti-windup: tracking in the plane, clamping in height."""
    per_thrust = GRAVITY_MPS2 / p.hover_thrust
    made_x, made_y = direction[0] * thrust * per_thrust, direction[1] * thrust * per_thrust
    short = a_sp[0] * a_sp[0] + a_sp[1] * a_sp[1] > made_x * made_x + made_y * made_y + 1e-12
    tracking = choose(short, 2.0 / p.xy_vel_p_per_s, 0.0)
    x, y, z = error[0] - tracking * (a_sp[0] - made_x), error[1] - tracking * (a_sp[1] - made_y), error[2]
    up = direction[2] * thrust
    stuck = ((up <= p.thr_min) & (z <= 0.0)) | ((up >= p.thr_max) & (z >= 0.0))
    return choose(_unset(x), 0.0, x), choose(_unset(y), 0.0, y), choose(_unset(z) | stuck, 0.0, z)


def _rate_setpoint(state: CascadeState, estimate: Estimate, p: Cascade, k: _Arrays) -> Array:
    """Attitude P, (..., 3) rad/s in the body frame."""
    error = attitude_error(estimate.q_WB_wxyz, state.thrust_direction_W, state.yaw_rad, p.yaw_weight)
    return np.minimum(np.maximum(k.att_p * error, -k.rate_max), k.rate_max)


def _rate_loop(
    state: CascadeState, estimate: Estimate, rate_sp: Array, dt: float, p: Cascade, k: _Arrays
) -> tuple[CascadeState, Array]:
    """Rate PID with the derivative on the filtered gyro; torque as a fraction of the motors' authority, (..., 3)."""
    rate = state.rate + k.gyro_gain * (estimate.omega_B - state.rate)
    slope = (rate - state.rate) / dt
    turn = state.angular_acceleration + k.derivative_gain * (slope - state.angular_acceleration)
    error = rate_sp - rate
    torque = k.rate_p * error + state.rate_integral - k.rate_d * turn
    fade = np.maximum(0.0, 1.0 - (error / _FADING_RATE_RAD_S) ** 2)
    integral = state.rate_integral + dt * k.rate_i * fade * error
    integral = np.minimum(np.maximum(integral, -p.rate_integral_max), p.rate_integral_max)
    return state._replace(rate=rate, angular_acceleration=turn, rate_integral=integral), torque
