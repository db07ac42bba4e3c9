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

Rotations are written as matrix products with constant tables: at 1 kHz for a single drone this costs a tenth of the
component form. Everything broadcasts over leading axes. Source: robotModel, with the vehicle that the paper idealises.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from services.parameters import NonNegative, Positive, parameters
from services.physics import GRAVITY_MPS2, Z

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Rows: motors 1 to 4; where each one stands (forward, left) in units of arm length, and the sign of its reaction torque.
FORWARD = np.array([1.0, -1.0, 1.0, -1.0]) * math.sqrt(0.5)
LEFT = np.array([-1.0, 1.0, 1.0, -1.0]) * math.sqrt(0.5)
SPIN = np.array([-1.0, -1.0, 1.0, 1.0])

_NEXT, _AFTER_NEXT = [1, 2, 0], [2, 0, 1]


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


def _rotation_table() -> Array:
    """(16, 9): the entries of R_WB, row by row, as quadratic forms of (w, x, y, z)."""
    sums = "ww+xx-yy-zz xy+xy-wz-wz xz+xz+wy+wy xy+xy+wz+wz ww-xx+yy-zz yz+yz-wx-wx xz+xz-wy-wy yz+yz+wx+wx ww-xx-yy+zz"
    table = np.zeros((4, 4, 9))
    for column, terms in enumerate(sums.split()):
        for term in terms.replace("-", " -").replace("+", " +").split():
            sign = -1.0 if term[0] == "-" else 1.0
            table["wxyz".index(term[-2]), "wxyz".index(term[-1]), column] += sign
    return table.reshape(16, 9)


def _rate_table() -> Array:
    """(12, 4): q ⊗ (0, ω) as a bilinear form of ω and q."""
    table = np.zeros((3, 4, 4))
    products = ((1, 0, -1, 0), (2, 0, -1, 1), (3, 0, -1, 2))  # w: -(xωx + yωy + zωz)
    products += ((0, 1, 1, 0), (2, 1, 1, 2), (3, 1, -1, 1))  # x: wωx + yωz - zωy
    products += ((0, 2, 1, 1), (1, 2, -1, 2), (3, 2, 1, 0))  # y: wωy - xωz + zωx
    products += ((0, 3, 1, 2), (1, 3, 1, 1), (2, 3, -1, 0))  # z: wωz + xωy - yωx
    for i, k, sign, axis in products:
        table[axis, i, k] = sign
    return table.reshape(12, 4)


_ROTATION, _RATE = _rotation_table(), _rate_table()


def rotation(q_WB_wxyz: Array) -> Array:
    """R_WB of a unit quaternion, (..., 3, 3)."""
    outer = q_WB_wxyz[..., :, None] * q_WB_wxyz[..., None, :]
    shape = q_WB_wxyz.shape[:-1]
    return (outer.reshape(shape + (16,)) @ _ROTATION).reshape(shape + (3, 3))


def turn(q_WB_wxyz: Array, omega_B: Array, dt: float) -> Array:
    """q after `dt` at a constant body rate, (..., 4): the Cayley map, of third order in the angle of one step."""
    outer = omega_B[..., :, None] * q_WB_wxyz[..., None, :]
    q = q_WB_wxyz + (0.5 * dt) * (outer.reshape(outer.shape[:-2] + (12,)) @ _RATE)
    return q / np.sqrt((q * q).sum(-1, keepdims=True))


def torque_B(rotor_thrust_N: Array, p: Quadrotor) -> Array:
    """The rotors' torque about the centre of mass in N m, (..., 3), body frame."""
    lever = np.array([p.arm_length_m * LEFT, -p.arm_length_m * FORWARD, p.torque_per_thrust_m * SPIN])
    return rotor_thrust_N @ lever.T


def step(state: QuadrotorState, motor: Array, f_ext_W: Array, dt: float, p: Quadrotor) -> QuadrotorState:
    """One step: exact motor lag, semi-implicit Euler for the body, then the floor.

    `motor` is (..., 4) in 0..1, `f_ext_W` (..., 3) in N; stable for dt up to 5 ms, meant for 1 ms.
    """
    target = p.rotor_thrust_max_N * np.minimum(np.maximum(motor, 0.0), 1.0)
    lag = -math.expm1(-dt / p.motor_time_constant_s)
    thrust = state.rotor_thrust_N + lag * (target - state.rotor_thrust_N)
    omega = state.omega_B + dt * _angular_acceleration(state.omega_B, thrust, p)
    q = turn(state.q_WB_wxyz, omega, dt)
    force = _pull(rotation(q), thrust, state.v_W, f_ext_W, p)
    v = state.v_W + dt * (force / p.mass_kg - GRAVITY_MPS2 * Z)
    moved = QuadrotorState(state.p_W + dt * v, v, q, omega, thrust)
    return _floor(moved, state, p)


def specific_force_B(state: QuadrotorState, f_ext_W: Array, p: Quadrotor) -> Array:
    """What an ideal accelerometer at the centre of mass reads in m/s², (..., 3): all forces but gravity, over the mass.

    The cable's pull is part of it, and so is the floor's push on a drone that stands.
    """
    R_WB = rotation(state.q_WB_wxyz)
    reading_W = _pull(R_WB, state.rotor_thrust_N, state.v_W, f_ext_W, p) / p.mass_kg
    stands = _touches(state.p_W, p) & (reading_W[..., 2] < GRAVITY_MPS2)
    reading_W = np.where(stands[..., None], GRAVITY_MPS2 * Z, reading_W)
    return (reading_W[..., None, :] @ R_WB)[..., 0, :]


def _angular_acceleration(omega: Array, thrust: Array, p: Quadrotor) -> Array:
    """Euler's equation in rad/s², (..., 3), body frame."""
    xx, yy, zz = p.inertia_xx_kgm2, p.inertia_yy_kgm2, p.inertia_zz_kgm2
    gyroscopic = omega[..., _NEXT] * omega[..., _AFTER_NEXT] * np.array([yy - zz, zz - xx, xx - yy])
    return (torque_B(thrust, p) + gyroscopic) / np.array([xx, yy, zz])


def _pull(R_WB: Array, thrust: Array, v_W: Array, f_ext_W: Array, p: Quadrotor) -> Array:
    """Rotors, air and cable together in N, (..., 3), world frame; gravity and floor excluded."""
    return R_WB[..., 2] * thrust.sum(-1, keepdims=True) + f_ext_W - p.drag_Ns_per_m * v_W


def _touches(p_W: Array, p: Quadrotor) -> Flags:
    return p_W[..., 2] <= p.gear_height_m


def _floor(moved: QuadrotorState, before: QuadrotorState, p: Quadrotor) -> QuadrotorState:
    """The floor stops whatever sinks into it: no bounce, no sliding, no turning, gear flat on the ground."""
    sinks = _touches(moved.p_W, p) & (moved.v_W[..., 2] <= 0.0)
    if not np.any(sinks):
        return moved
    held = sinks[..., None]
    p_W = np.where(held, before.p_W * [1.0, 1.0, 0.0] + p.gear_height_m * Z, moved.p_W)
    q = np.where(held, _level(before.q_WB_wxyz), moved.q_WB_wxyz)
    still = np.where(held, 0.0, 1.0)
    return moved._replace(p_W=p_W, v_W=moved.v_W * still, q_WB_wxyz=q, omega_B=moved.omega_B * still)


def _level(q_WB_wxyz: Array) -> Array:
    """The same heading without tilt: twist about z."""
    q = q_WB_wxyz * [1.0, 0.0, 0.0, 1.0]
    return q / np.sqrt((q * q).sum(-1, keepdims=True))
