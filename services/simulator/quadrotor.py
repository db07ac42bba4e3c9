"""The vehicle's body: a rigid body that four rotors carry and turn, and a floor under it.

| symbol | here | unit | frame |
|---|---|---|---|
| p_R, v_R | p_W, v_W | m, m/s | W |
| attitude, body rate | q_WB_wxyz, omega_B | -, rad/s | B to W, B |
| thrust of each rotor | rotor_thrust_N | N | along z of B |
| m_R | mass_kg | kg | |
| force from outside (the cable: -f_c) | f_ext_W | N | W, at the centre of mass |

Motors are numbered as in PX4's X: 1 front right, 2 rear left (both turn counter-clockwise seen from above), 3 front left,
4 rear right (clockwise). The arms stand at 45° to x of B (forward) and y of B (left). A motor command is a fraction of
the largest thrust, so the command is linear in thrust.

Written in components (physics.py) for the sake of 1 kHz. Everything broadcasts over leading axes. Source: robotModel, with
the vehicle that the paper idealises.
"""

import math
from typing import NamedTuple

import numpy as np

from services.parameters import NonNegative, Positive, parameters
from services.physics import (
    GRAVITY_MPS2,
    Array,
    Components,
    Scalar,
    Z,
    anywhere,
    choose,
    clamp,
    components,
    conjugate,
    rotate,
    vector,
)

# Rows: motors 1 to 4; where each one stands (forward, left) in units of arm length, and the sign of its reaction torque.
DIAGONAL = math.sqrt(0.5)
FORWARD = np.array([1.0, -1.0, 1.0, -1.0]) * DIAGONAL
LEFT = np.array([-1.0, 1.0, 1.0, -1.0]) * DIAGONAL
SPIN = np.array([-1.0, -1.0, 1.0, 1.0])


@parameters
class Quadrotor:
    """An X quadrotor; `torque_per_thrust_m` is a rotor's reaction torque over its thrust."""

    mass_kg: Positive
    inertia_xx_kgm2: Positive
    inertia_yy_kgm2: Positive
    inertia_zz_kgm2: Positive
    arm_length_m: Positive
    rotor_thrust_max_N: Positive
    torque_per_thrust_m: Positive
    motor_time_constant_s: Positive
    drag_Ns_per_m: NonNegative
    gear_height_m: NonNegative


class QuadrotorState(NamedTuple):
    """p_W, v_W, omega_B: (..., 3); q_WB_wxyz and rotor_thrust_N: (..., 4)."""

    p_W: Array
    v_W: Array
    q_WB_wxyz: Array
    omega_B: Array
    rotor_thrust_N: Array


def at_rest(p_W: Array, p: Quadrotor, *, hovering: bool = False) -> QuadrotorState:
    """Level and still at `p_W` (..., 3), rotors stopped or at hover thrust."""
    zero = np.zeros_like(p_W)
    four = np.zeros(p_W.shape[:-1] + (4,))
    thrust = four + (p.mass_kg * GRAVITY_MPS2 / 4 if hovering else 0.0)
    return QuadrotorState(p_W.astype(float), zero, four + [1.0, 0.0, 0.0, 0.0], zero, thrust)


def turn(q_WB_wxyz: Array, omega_B: Array, dt: float) -> Array:
    """q after `dt` at a constant body rate, (..., 4): the Cayley map, of third order in the angle of one step."""
    return vector(*_turned(components(q_WB_wxyz), components(omega_B), dt))


def step(state: QuadrotorState, motor: Array, f_ext_W: Array, dt: float, p: Quadrotor) -> QuadrotorState:
    """One step: exact motor lag, semi-implicit Euler for the body, then the floor.

    `motor` is (..., 4) in 0..1, `f_ext_W` (..., 3) in N; stable for dt up to 5 ms, meant for 1 ms.
    """
    lag, strongest = -math.expm1(-dt / p.motor_time_constant_s), p.rotor_thrust_max_N
    motors = zip(components(state.rotor_thrust_N), components(motor), strict=True)
    thrust = [f + lag * (strongest * clamp(m, 0.0, 1.0) - f) for f, m in motors]
    omega = _spun(components(state.omega_B), thrust, dt, p)
    q = _turned(components(state.q_WB_wxyz), omega, dt)
    before = components(state.v_W)
    f_x, f_y, f_z = _pull(q, thrust, before, components(f_ext_W), p)
    v = (
        before[0] + dt * (f_x / p.mass_kg),
        before[1] + dt * (f_y / p.mass_kg),
        before[2] + dt * (f_z / p.mass_kg - GRAVITY_MPS2),
    )
    v_W = vector(*v)
    moved = QuadrotorState(state.p_W + dt * v_W, v_W, vector(*q), vector(*omega), vector(*thrust))
    sinks = _touches(components(moved.p_W), p) & (v[2] <= 0.0)
    return _stopped(moved, state, sinks, p) if anywhere(sinks) else moved


def specific_force_B(state: QuadrotorState, f_ext_W: Array, p: Quadrotor) -> Array:
    """What an ideal accelerometer at the centre of mass reads in m/s², (..., 3): all forces but gravity, over the mass.

    The cable's pull is part of it, and so is the floor's push on a drone that stands.
    """
    q, thrust, v = (components(x) for x in (state.q_WB_wxyz, state.rotor_thrust_N, state.v_W))
    reading_W = vector(*_pull(q, thrust, v, components(f_ext_W), p)) / p.mass_kg
    stands = np.asarray(_touches(components(state.p_W), p) & (reading_W[..., 2] < GRAVITY_MPS2))
    reading_W = np.where(stands[..., None], GRAVITY_MPS2 * Z, reading_W)
    return rotate(conjugate(state.q_WB_wxyz), reading_W)


def _spun(omega: Components, thrust: Components, dt: float, p: Quadrotor) -> Components:
    """Euler's equation: the body rate `dt` later, rad/s in the body frame."""
    front_right, rear_left, front_left, rear_right = thrust
    x, y, z = omega
    xx, yy, zz = p.inertia_xx_kgm2, p.inertia_yy_kgm2, p.inertia_zz_kgm2
    lever_m = p.arm_length_m * DIAGONAL
    roll = lever_m * (rear_left + front_left - front_right - rear_right)
    pitch = lever_m * (rear_left + rear_right - front_right - front_left)
    yaw = p.torque_per_thrust_m * (front_left + rear_right - front_right - rear_left)
    return (
        x + dt * (roll + (yy - zz) * y * z) / xx,
        y + dt * (pitch + (zz - xx) * z * x) / yy,
        z + dt * (yaw + (xx - yy) * x * y) / zz,
    )


def _turned(q: Components, omega: Components, dt: float) -> Components:
    """q ⊗ (1, ½ ω dt), of unit length."""
    w, x, y, z = q
    a, b, c = (0.5 * dt * rate for rate in omega)
    turned = (
        w - x * a - y * b - z * c,
        x + w * a + y * c - z * b,
        y + w * b - x * c + z * a,
        z + w * c + x * b - y * a,
    )
    w, x, y, z = turned
    length = (w * w + x * x + y * y + z * z) ** 0.5
    return w / length, x / length, y / length, z / length


def _pull(q: Components, thrust: Components, v: Components, f_ext: Components, p: Quadrotor) -> Components:
    """Rotors, air and cable together in N, world frame; gravity and floor excluded."""
    w, x, y, z = q
    total, drag = 2.0 * sum(thrust), p.drag_Ns_per_m
    return (
        total * (x * z + w * y) + f_ext[0] - drag * v[0],
        total * (y * z - w * x) + f_ext[1] - drag * v[1],
        total * (0.5 - x * x - y * y) + f_ext[2] - drag * v[2],
    )


def _touches(p_W: Components, p: Quadrotor) -> Scalar:
    return p_W[2] <= p.gear_height_m


def _stopped(moved: QuadrotorState, before: QuadrotorState, sinks: Scalar, p: Quadrotor) -> QuadrotorState:
    """The floor stops whatever sinks into it: no bounce, no sliding, no turning, gear flat on the ground."""
    held = np.asarray(sinks)[..., None]
    p_W = np.where(held, before.p_W * [1.0, 1.0, 0.0] + p.gear_height_m * Z, moved.p_W)
    q = np.where(held, _level(before.q_WB_wxyz), moved.q_WB_wxyz)
    still = np.where(held, 0.0, 1.0)
    return QuadrotorState(p_W, moved.v_W * still, q, moved.omega_B * still, moved.rotor_thrust_N)


def _level(q_WB_wxyz: Array) -> Array:
    """The same heading without tilt: twist about z."""
    w, _, _, z = components(q_WB_wxyz)
    w = choose(w * w + z * z < 1e-12, 1.0, w)  # on its back it has no heading
    length = (w * w + z * z) ** 0.5
    return vector(w / length, 0.0 * w, 0.0 * w, z / length)
