"""The hand's filter: the lag it states, outliers kept out, a lost hand called lost."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services import cable
from services.physics import Array, norm
from services.tracker import filtering
from services.tracker.filtering import Sample
from tests.laws.strategies import FORCES, vectors

P = filtering.Filter(tau_s=0.03, gate_m=0.05, gate_mps=3.0, lost_s=0.3, settle_s=0.1)
DT = 1.0 / 60.0
VECTOR = vectors(1.0)


def run(z_of_t: Array, dt: float = DT, measured: bool = True) -> tuple[filtering.State, filtering.Output]:
    state = filtering.start()
    for z in z_of_t[:-1]:
        state, _ = filtering.step(state, z, measured, dt, P)
    return filtering.step(state, z_of_t[-1], measured, dt, P)


@given(VECTOR, VECTOR)
def test_no_lag_at_constant_velocity(p_0: Array, v: Array) -> None:
    t = np.arange(120)[:, None] * DT
    _, out = run(p_0 + v * t)
    assert out.p == pytest.approx(p_0 + v * t[-1], abs=1e-9)
    assert out.v == pytest.approx(v, abs=1e-9)
    assert out.valid


@settings(max_examples=25)
@given(VECTOR)
def test_the_stated_lag_at_constant_acceleration(a: Array) -> None:
    t = np.arange(400)[:, None] * 1e-3
    _, out = run(0.5 * a * t**2, 1e-3)
    assert 0.5 * a * t[-1] ** 2 - out.p == pytest.approx(a * P.tau_s**2, abs=0.05 * P.tau_s**2)
    assert a * t[-1] - out.v == pytest.approx(2 * P.tau_s * a, abs=0.1 * P.tau_s)


def test_noise_of_a_millimetre_becomes_little_speed() -> None:
    rng, state, speeds = np.random.default_rng(3), filtering.start(), []
    for _ in range(2000):
        state, out = filtering.step(state, rng.normal(0.0, 1e-3, 3), True, DT, P)
        speeds.append(out.v)
    print(f"velocity noise {np.std(speeds[50:]):.3f} m/s for 1 mm")
    assert np.std(speeds[50:]) < 0.03


@given(VECTOR.filter(lambda v: norm(v) > 0.2), st.integers(1, 10))
def test_a_jump_is_kept_out_and_coasted_over(jump: Array, frames: int) -> None:
    t = np.arange(60)[:, None] * DT
    state, _ = run(0.2 * t * np.ones(3))
    for k in range(frames):
        gate = P.gate_m + P.gate_mps * (k + 1) * DT
        truth = (t[-1] + (k + 1) * DT) * 0.2 * np.ones(3)
        state, out = filtering.step(state, truth + jump * (1.0 + gate / norm(jump)), True, DT, P)
        assert out.sample == Sample.JUMP
        assert out.p == pytest.approx(truth, abs=1e-6)


def test_a_frame_that_stays_shifted_restarts_after_lost_s_and_is_invalid_meanwhile() -> None:
    state, _ = run(np.zeros((60, 3)))
    samples, valid = [], []
    for _ in range(40):
        state, out = filtering.step(state, np.array([5.0, 0.0, 0.0]), True, DT, P)
        samples.append(int(out.sample))
        valid.append(bool(out.valid))
    restart = samples.index(Sample.RESTART)
    assert restart * DT == pytest.approx(P.lost_s, abs=2 * DT)
    assert not any(valid[restart : restart + 6])  # until settle_s
    assert all(valid[restart + 7 :])
    assert set(samples[restart + 1 :]) == {Sample.ACCEPTED}


def test_a_missing_hand_coasts_then_is_lost() -> None:
    t = np.arange(60)[:, None] * DT
    state, out = run(0.3 * t * np.ones(3))
    for k in range(30):
        state, out = filtering.step(state, np.full(3, 99.0), False, DT, P)
        assert out.sample == Sample.MISSING
        assert bool(out.valid) == ((k + 1) * DT <= P.lost_s + 1e-9)
    assert out.v == pytest.approx([0.3] * 3)


def test_nothing_seen_is_not_valid() -> None:
    _, out = run(np.zeros((100, 3)), measured=False)
    assert not out.valid


@given(VECTOR, FORCES.filter(lambda f: norm(f) > 0.35))
def test_fallback_finds_the_hand_of_a_taut_cable(p_H: Array, f_c: Array) -> None:
    c = cable.Cable(rest_length_m=1.0, k_c_N_per_m=200.0)
    found, usable = filtering.fallback(p_H + cable.offset(f_c, c), f_c, c, 0.3)
    assert usable
    assert found == pytest.approx(p_H, abs=1e-9)


@given(vectors(0.15))
def test_fallback_refuses_a_small_force(f_c: Array) -> None:
    found, usable = filtering.fallback(np.zeros(3), f_c, cable.Cable(rest_length_m=1.0, k_c_N_per_m=200.0), 0.3)
    assert not usable
    assert np.all(np.isfinite(found))


def test_it_broadcasts() -> None:
    z = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [2.0, 0.0, 1.0]])
    state = filtering.State(0.99 * z, 0.1 * z, np.array([0.0, 0.0, 1.0]), np.zeros(3), np.array([1.0, 0.0, 1.0]))
    measured = np.array([True, False, True])
    together = filtering.step(state, z, measured, DT, P)
    for i in range(3):
        one = filtering.step(filtering.State(*(v[i] for v in state)), z[i], measured[i], DT, P)
        for a, b in zip((*together[0], *together[1]), (*one[0], *one[1]), strict=True):
            assert a[i] == pytest.approx(b)
