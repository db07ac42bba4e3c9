"""The force bias: weighed in hover, then watched through what the cable cannot do."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.force_estimator import bias
from services.physics import Array, norm
from tests.laws.strategies import UNIT, vectors

P = bias.Bias(
    handle_weight_N=0.29,
    tare_s=6.0,
    tare_std_max_N=0.3,
    tare_bias_max_N=1.5,
    watch_s=5.0,
    slack_margin_m=0.02,
)
SMALL = vectors(0.4)
WEIGHT = np.array([0.0, 0.0, 0.29])


def tared(f_of_t: Array, dt: float) -> bias.Tare:
    state = bias.tare_start()
    for f in f_of_t:
        state = bias.tare_step(state, f, dt)
    return bias.tare_result(state, P)


@given(SMALL, st.floats(0.0, 0.35), st.floats(0.0, 6.28))
def test_tare_finds_the_bias_under_a_swinging_handle(offset: Array, swing_rad: float, phase: float) -> None:
    """The swing (period 2 s) averages out; the tension's mean is the weight to second order in the angle."""
    angle = swing_rad * np.sin(np.pi * np.arange(0, 6, 0.02) + phase)
    pull = 0.29 * np.stack((np.sin(angle), 0.0 * angle, np.cos(angle)), axis=-1)
    result = tared(pull + offset, 0.02)
    assert result.reason == ""
    assert result.bias == pytest.approx(offset, abs=0.02)


@given(SMALL)
def test_after_the_tare_a_thrust_error_of_five_percent_is_gone(offset: Array) -> None:
    f = WEIGHT + offset + np.array([0.0, 0.0, 0.39])
    assert f - tared(np.tile(f, (301, 1)), 0.02).bias == pytest.approx(WEIGHT, abs=1e-12)


def test_a_bad_tare_says_why() -> None:
    steady = np.tile(WEIGHT, (301, 1))
    assert "averaged over 2.00 s" in tared(steady[:100], 0.02).reason
    assert "limit tare_std_max_N = 0.3" in tared(steady + np.sin(np.arange(301))[:, None], 0.02).reason
    assert "limit tare_bias_max_N = 1.5" in tared(steady + 1.2, 0.02).reason
    assert tared(steady, 0.02).reason == ""


def watched(change: Array, f_c: Array, l_c: Array, seconds: float, seen: bool = True, held: bool = True) -> Array:
    for _ in range(round(seconds / 0.05)):
        change = bias.watch(change, f_c, l_c, seen, held, 0.05, 1.0, P)
    return change


@given(SMALL, UNIT, st.floats(0.0, 5.0), st.booleans())
def test_taut_what_is_across_the_cable_is_bias(offset: Array, l_hat: Array, tension: float, held: bool) -> None:
    found = watched(np.zeros(3), tension * l_hat + offset, 1.005 * l_hat, 40.0, held=held)
    across = offset - (offset @ l_hat) * l_hat
    assert found == pytest.approx(across, abs=1e-3)
    assert float(norm(found - offset)) <= float(norm(offset)) + 1e-9  # never worse than not watching


@given(SMALL, UNIT)
def test_held_and_slack_all_of_it_is_bias(offset: Array, l_hat: Array) -> None:
    assert watched(np.zeros(3), offset, 0.9 * l_hat, 40.0) == pytest.approx(offset, abs=1e-3)


@given(SMALL, SMALL, UNIT, st.floats(0.5, 1.2), st.booleans())
def test_frozen_unseen_or_slack_in_nobodys_hand(
    before: Array, f_c: Array, l_hat: Array, length: float, held: bool
) -> None:
    assert np.array_equal(watched(before, f_c, length * l_hat, 1.0, seen=False, held=held), before)
    assert np.array_equal(watched(before, f_c, 0.9 * l_hat, 1.0, held=False), before)


@given(SMALL)
def test_vertical_bias_on_a_vertical_cable_stays_hidden(offset: Array) -> None:
    found = watched(np.zeros(3), WEIGHT + offset, np.array([0.0, 0.0, 1.0]), 40.0)
    assert found == pytest.approx([offset[0], offset[1], 0.0], abs=1e-3)


def test_it_takes_its_five_seconds() -> None:
    found = watched(np.zeros(3), np.array([0.3, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]), 5.0)
    assert found[0] == pytest.approx(0.3 * (1.0 - np.exp(-1.0)))


def test_it_broadcasts() -> None:
    l_c = np.array([[0.0, 0.0, 1.1], [0.0, 0.0, 0.9], [0.8, 0.0, 0.8]])
    f, held = np.full((3, 3), 0.2), np.array([True, True, False])
    together = bias.watch(np.zeros((3, 3)), f, l_c, np.array([True, True, False]), held, 0.1, 1.0, P)
    for i in range(3):
        one = bias.watch(np.zeros(3), f[i], l_c[i], i < 2, held[i], 0.1, 1.0, P)
        assert together[i] == pytest.approx(one)
    assert bias.is_slack(l_c, 1.0, 0.02).tolist() == [False, True, False]
