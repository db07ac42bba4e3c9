"""The wrench observer finds the force that the cable puts on the vehicle, in world axes, with the lag it states."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.force_estimator import observer
from services.physics import GRAVITY_MPS2, Array, Z, conjugate, norm, rotate
from tests.laws.strategies import DT, FORCES, QUATERNIONS, vectors

P = observer.Observer(m_R_kg=0.8, bandwidth_Hz=8.0)
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


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


def respond(forces: Array, dt: float, p: observer.Observer = P) -> Array:
    """f̂_c of a level vehicle at hover thrust after each of the samples `forces`, (n, 3)."""
    q, state, out = LEVEL, observer.start(), list[Array]()
    for f_c in forces:
        state, f_hat = observer.step(state, imu(q, f_c, 7.8), q, 7.8, dt, p)
        out.append(f_hat)
    return np.array(out)


BANDWIDTHS = st.floats(0.5, 60.0).map(lambda Hz: observer.Observer(m_R_kg=0.8, bandwidth_Hz=Hz))


@given(BANDWIDTHS, FORCES, st.floats(1e-4, 0.02))
def test_an_impulse_fades_as_derived(p: observer.Observer, f_c: Array, dt: float) -> None:
    """One sample f: gain f at once, then (1 - gain)^n of it; the sum over all time is f: nothing is lost."""
    forces = np.zeros((40, 3))
    forces[0] = f_c
    out, kept = respond(forces, dt, p), np.exp(-2 * np.pi * p.bandwidth_Hz * dt)
    n = np.arange(40)[:, None]
    assert out == pytest.approx((1.0 - kept) * kept**n * f_c, abs=1e-9)
    assert out.sum(0) == pytest.approx((1.0 - kept**40) * f_c, abs=1e-8)


@given(BANDWIDTHS, FORCES, st.floats(1e-4, 0.02))
def test_a_step_rises_as_derived_and_a_bias_comes_through_whole(p: observer.Observer, f_c: Array, dt: float) -> None:
    """After n samples 1 - exp(-ω n dt) of it; in the end all of it, so a constant bias is a bias of f̂_c of the same size."""
    out, n = respond(np.tile(f_c, (40, 1)), dt, p), np.arange(1, 41)[:, None]
    assert out == pytest.approx((1.0 - np.exp(-2 * np.pi * p.bandwidth_Hz * n * dt)) * f_c, abs=1e-9)
    settled, _ = observer.step(observer.State(-f_c), imu(LEVEL, f_c, 7.8), LEVEL, 7.8, dt, p)
    assert settled.f_ext == pytest.approx(-f_c, abs=1e-12)


@given(BANDWIDTHS, vectors(0.5), QUATERNIONS)
def test_a_bias_of_the_accelerometer_is_mass_times_it(p: observer.Observer, bias_mps2: Array, q: Array) -> None:
    """In the body's axes, turned into the world's."""
    state, f_hat = observer.start(), np.zeros(3)
    for _ in range(40):
        a_B = imu(q, np.zeros(3), 7.8) + bias_mps2
        state, f_hat = observer.step(state, a_B, q, 7.8, 0.1 / p.bandwidth_Hz, p)
    assert f_hat == pytest.approx(-0.8 * rotate(q, bias_mps2), abs=1e-9)


@pytest.mark.parametrize(("bandwidth_Hz", "dt"), [(8.0, 0.004), (2.0, 0.001), (20.0, 0.004)])
def test_white_noise_comes_out_with_the_derived_variance(bandwidth_Hz: float, dt: float) -> None:
    """σ² gain/(2 - gain): at 8 Hz and 250 Hz a third of σ; and its correlation from sample to sample is 1 - gain."""
    p, n = observer.Observer(m_R_kg=0.8, bandwidth_Hz=bandwidth_Hz), 30_000
    noise = np.random.default_rng(3).normal(0.0, 0.05, (n, 3))
    gain = 1.0 - np.exp(-2 * np.pi * bandwidth_Hz * dt)
    out = respond(noise, dt, p)[2000:]
    effective = len(out) * 3 * gain  # samples that are as good as independent
    assert np.var(out) == pytest.approx(0.05**2 * gain / (2.0 - gain), rel=5.0 * np.sqrt(2.0 / effective))
    correlation = np.mean(out[1:] * out[:-1]) / np.var(out)
    assert correlation == pytest.approx(1.0 - gain, abs=0.01)


def test_as_dt_shrinks_it_becomes_the_continuous_observer() -> None:
    """Against ḟ = ω (f_ext - f) solved on paper for a sine: the difference is of order 1 in dt, half a sample of lag."""
    omega, w = 2 * np.pi * 8.0, 2 * np.pi * 1.5
    errors: list[float] = []
    for dt in (0.004, 0.002, 0.001, 0.0005):
        t = dt * np.arange(round(1.0 / dt))
        out = respond(np.outer(np.sin(w * t), [1.0, 0.0, 0.0]), dt)[:, 0]
        after = t + dt  # a sample is held until the next
        share = omega / (omega**2 + w**2)
        exact = share * (omega * np.sin(w * after) - w * np.cos(w * after) + w * np.exp(-omega * after))
        errors.append(float(np.max(np.abs(out - exact))))
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx([1.0] * 3, abs=0.05)
    assert errors[-1] < 0.6 * w * 0.0005


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
