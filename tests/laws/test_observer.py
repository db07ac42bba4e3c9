"""The wrench observer finds the force that the cable puts on the vehicle, in world axes, with the lag it states."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.force_estimator import observer
from services.physics import GRAVITY_MPS2, Array, Z, conjugate, norm, rotate
from tests.laws.strategies import DT, FORCES, QUATERNIONS

P = observer.Observer(m_R_kg=0.8, bandwidth_Hz=8.0)


def imu(q: Array, f_c: Array, thrust_N: float, m_R: float = 0.8) -> Array:
    """Specific force of a vehicle that feels thrust, weight and -f_c."""
    a_W = (rotate(q, thrust_N * Z) - f_c) / m_R - GRAVITY_MPS2 * Z
    return rotate(conjugate(q), a_W + GRAVITY_MPS2 * Z)


@given(QUATERNIONS, FORCES, st.floats(0.0, 20.0))
def test_raw_force_is_minus_the_cable_force(q: Array, f_c: Array, thrust_N: float) -> None:
    """Whatever the attitude and however it accelerates."""
    assert observer.raw(imu(q, f_c, thrust_N), q, thrust_N, 0.8) == pytest.approx(-f_c, abs=1e-9)


@given(FORCES, DT, DT)
def test_the_filter_is_exact_for_any_step(f_c: Array, dt_1: float, dt_2: float) -> None:
    q = np.array([1.0, 0.0, 0.0, 0.0])
    a_B = imu(q, f_c, 7.8)
    state, _ = observer.step(observer.start(), a_B, q, 7.8, dt_1, P)
    state, f_hat = observer.step(state, a_B, q, 7.8, dt_2, P)
    assert f_hat == pytest.approx(f_c * (1.0 - np.exp(-2 * np.pi * 8.0 * (dt_1 + dt_2))), abs=1e-9)


def test_a_sine_at_the_bandwidth_comes_out_3_db_lower() -> None:
    q, dt = np.array([1.0, 0.0, 0.0, 0.0]), 1e-4
    state, peak = observer.start(), 0.0
    for k in range(6000):
        f_c = np.array([np.sin(2 * np.pi * 8.0 * k * dt), 0.0, 0.0])
        state, f_hat = observer.step(state, imu(q, f_c, 7.8), q, 7.8, dt, P)
        peak = max(peak, abs(float(f_hat[0]))) if k > 4000 else 0.0
    assert peak == pytest.approx(np.sqrt(0.5), rel=0.01)


@given(QUATERNIONS, st.floats(-0.1, 0.1))
def test_an_error_of_thrust_is_a_bias_along_the_body(q: Array, error: float) -> None:
    """G8: the observer cannot tell; 5 % of 7.8 N is 0.39 N."""
    wrong = observer.raw(imu(q, np.zeros(3), 7.8), q, 7.8 * (1.0 + error), 0.8)
    assert float(norm(wrong)) == pytest.approx(7.8 * abs(error), abs=1e-9)


def test_it_broadcasts_and_leaves_its_input_alone() -> None:
    q = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]])
    a_B, thrust = np.array([[1.0, 2.0, 9.0], [0.0, 1.0, 8.0]]), np.array([7.0, 8.0])
    kept = a_B.copy()
    _, together = observer.step(observer.start((2,)), a_B, q, thrust, 0.004, P)
    assert np.array_equal(kept, a_B)
    for i in range(2):
        _, one = observer.step(observer.start(), a_B[i], q[i], float(thrust[i]), 0.004, P)
        assert together[i] == pytest.approx(one)
