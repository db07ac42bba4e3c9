"""The rigid body against mechanics."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.config import load_vehicle
from services.physics import GRAVITY_MPS2, integrate_attitude, norm, rotation_matrix
from services.simulator import quadrotor
from services.simulator.quadrotor import QuadrotorState

P = load_vehicle("medium").quadrotor
HOVER = P.mass_kg * GRAVITY_MPS2 / (4 * P.rotor_thrust_max_N)
NOTHING = np.zeros(3)
DT = 0.001
HIGH = np.array([0.0, 0.0, 10.0])

vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)
quaternions = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4).map(np.array).filter(lambda q: norm(q) > 0.1).map(lambda q: q / norm(q))
)


def fly(state: QuadrotorState, motor: np.ndarray, seconds: float, f_ext=NOTHING, p=P) -> QuadrotorState:
    for _ in range(round(seconds / DT)):
        state = quadrotor.step(state, motor, f_ext, DT, p)
    return state


def test_hover_thrust_hovers():
    end = fly(quadrotor.at_rest(HIGH, P, hovering=True), np.full(4, HOVER), 2.0)
    assert end.p_W == pytest.approx(HIGH, abs=1e-9)


def test_without_motors_and_air_it_falls_freely_and_the_accelerometer_reads_zero():
    p = dataclasses.replace(P, drag_Ns_per_m=0.0)
    end = fly(quadrotor.at_rest(HIGH, p), np.zeros(4), 1.0, p=p)
    assert end.v_W[2] == pytest.approx(-GRAVITY_MPS2)
    assert end.p_W[2] == pytest.approx(10 - GRAVITY_MPS2 / 2, abs=0.01)
    assert quadrotor.specific_force_B(end, NOTHING, p) == pytest.approx(np.zeros(3), abs=1e-9)


def test_the_motors_lag_exactly():
    end = fly(quadrotor.at_rest(HIGH, P), np.ones(4), P.motor_time_constant_s)
    assert end.rotor_thrust_N == pytest.approx(np.full(4, P.rotor_thrust_max_N * (1 - math.exp(-1))))


@pytest.mark.parametrize(
    ("faster", "axis", "sign"),
    [
        ((0, 2), 1, -1),  # the front pair lifts the nose: negative rotation about y (left)
        ((1, 2), 0, +1),  # the left pair: positive rotation about x (forward)
        ((0, 1), 2, -1),  # the counter-clockwise pair turns the body clockwise
    ],
)
def test_motors_are_numbered_and_turn_as_in_px4s_x(faster, axis, sign):
    motor = np.full(4, HOVER)
    motor[list(faster)] += 0.02
    omega = fly(quadrotor.at_rest(HIGH, P, hovering=True), motor, 0.05).omega_B
    assert omega[axis] * sign > 0.0
    assert np.delete(omega, axis) == pytest.approx(np.zeros(2), abs=1e-9)


@given(quaternions, vectors)
def test_turning_agrees_with_the_shared_quaternion_algebra(q, omega):
    assert quadrotor.turn(q, omega, DT) == pytest.approx(integrate_attitude(q, omega, DT), abs=1e-8)


@settings(deadline=None, max_examples=50)
@given(quaternions, vectors)
def test_free_rotation_keeps_its_angular_momentum(q, omega):
    inertia = np.array([P.inertia_xx_kgm2, P.inertia_yy_kgm2, P.inertia_zz_kgm2])
    state = quadrotor.at_rest(HIGH, P)._replace(q_WB_wxyz=q, omega_B=omega)
    before = rotation_matrix(q) @ (inertia * omega)
    end = fly(state, np.zeros(4), 0.1)
    after = rotation_matrix(end.q_WB_wxyz) @ (inertia * end.omega_B)
    assert after == pytest.approx(before, abs=2e-3 * float(norm(before) + 0.01))


@given(quaternions, vectors, vectors)
def test_the_accelerometer_reads_acceleration_less_gravity(q, v, pull):
    state = quadrotor.at_rest(HIGH, P, hovering=True)._replace(q_WB_wxyz=q, v_W=v)
    after = quadrotor.step(state, np.full(4, HOVER), pull, 1e-6, P)
    acceleration = (after.v_W - v) / 1e-6
    reading_W = rotation_matrix(q) @ quadrotor.specific_force_B(state, pull, P)
    assert reading_W == pytest.approx(acceleration + [0.0, 0.0, GRAVITY_MPS2], abs=1e-3)


def test_it_stands_on_its_gear_and_takes_off():
    floor = np.array([1.0, 2.0, P.gear_height_m])
    pulled = fly(quadrotor.at_rest(floor, P), np.full(4, 0.5 * HOVER), 1.0, f_ext=np.array([0.5, 0.0, 0.0]))
    assert pulled.p_W == pytest.approx(floor)
    assert quadrotor.specific_force_B(pulled, NOTHING, P) == pytest.approx([0.0, 0.0, GRAVITY_MPS2])
    assert fly(pulled, np.full(4, 1.2 * HOVER), 1.0).p_W[2] > P.gear_height_m + 0.3


@settings(max_examples=25, deadline=None)
@given(quaternions, vectors)
def test_it_never_falls_through_the_floor(q, v):
    state = quadrotor.at_rest(np.array([0.0, 0.0, 0.3]), P)._replace(q_WB_wxyz=q, v_W=v, omega_B=v)
    for _ in range(1000):
        state = quadrotor.step(state, np.zeros(4), NOTHING, DT, P)
        assert state.p_W[2] >= P.gear_height_m - 1e-12
    assert state.v_W == pytest.approx(np.zeros(3))


@given(st.integers(0, 2**32 - 1))
def test_a_crowd_flies_as_each_would_alone(seed):
    random = np.random.default_rng(seed)
    draw = [random.normal(size=(4, n)) for n in (3, 3, 4, 3, 4)]
    draw[2] /= norm(draw[2])[:, None]
    crowd = QuadrotorState(*draw)
    motor, pull = random.uniform(size=(4, 4)), random.normal(size=(4, 3))
    together = quadrotor.step(crowd, motor, pull, DT, P)
    for i in range(4):
        alone = quadrotor.step(QuadrotorState(*(x[i] for x in crowd)), motor[i], pull[i], DT, P)
        for a, b in zip(alone, together, strict=True):
            assert a == pytest.approx(b[i], abs=1e-12)
