"""The estimator as a whole: zeroing by its rules, and a force that is what was observed less what is not the cable's."""

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.estimation import Tare
from services.force_estimator import estimator
from services.force_estimator.bias import Bias
from services.force_estimator.estimator import Estimate, Geometry, Sample, State
from services.force_estimator.observer import Observer
from services.physics import GRAVITY_MPS2, Array, conjugate, norm, rotate
from tests.laws.strategies import QUATERNIONS, vectors

M_KG, WEIGHT_N, DT, REST_M = 0.8, 0.3, 0.01, 1.0
OBSERVER = Observer(m_R_kg=M_KG, bandwidth_Hz=8.0)
BIAS = Bias(
    handle_weight_N=WEIGHT_N, tare_s=1.0, tare_std_max_N=0.3, tare_bias_max_N=1.5, watch_s=2.0, slack_margin_m=0.02
)
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
HANGING = Geometry(np.array([0.0, 0.0, 1.0]), seen=True, held=False)
PULLED = Geometry(np.array([0.6, 0.0, 0.8]), seen=True, held=True)
SLACK = Geometry(np.array([0.6, 0.0, 0.6]), seen=True, held=True)
HIDDEN = Geometry(np.zeros(3), seen=False, held=True)
FREE = np.array([0.0, 0.0, WEIGHT_N])
G8 = np.array([0.2, 0.2, 0.4])
FORCES, SMALL = vectors(3.0), vectors(0.5)


def sample(f_c: Array, lie: Array | float = 0.0, q: Array = LEVEL) -> Sample:
    """What the inertial unit says in hover under -f_c, when the force that explains it is believed to be `lie` more."""
    thrust_N = M_KG * GRAVITY_MPS2
    felt_W = thrust_N * rotate(q, np.array([0.0, 0.0, 1.0])) - f_c - lie
    return Sample(rotate(conjugate(q), felt_W / M_KG), q, thrust_N, DT)


def run(
    state: State, x: Sample, seconds: float, cable: Geometry = HANGING, *, zero: bool = False
) -> Iterator[tuple[State, Estimate]]:
    for _ in range(round(seconds / DT)):
        state, estimate = estimator.step(state, x, cable, zero, REST_M, OBSERVER, BIAS)
        yield state, estimate


def last(
    state: State, x: Sample, seconds: float, cable: Geometry = HANGING, *, zero: bool = False
) -> tuple[State, Estimate]:
    *_, end = run(state, x, seconds, cable, zero=zero)
    return end


def settled(x: Sample) -> State:
    """The observer has forgotten its start; nothing zeroed yet."""
    return last(estimator.initial(), x, 1.0)[0]


def zeroed(lie: Array | float = 0.0, handle: Array = FREE) -> State:
    x = sample(handle, lie)
    return last(settled(x), x, 1.2, zero=True)[0]


@given(FORCES, QUATERNIONS)
@settings(max_examples=30)
def test_before_zeroing_it_says_what_it_observes(f_c: Array, q: Array) -> None:
    """Whatever the attitude; and knows that it was never zeroed."""
    state, estimate = last(estimator.initial(), sample(f_c, q=q), 1.0, PULLED)
    assert estimate.f_c == pytest.approx(f_c, abs=1e-6)
    assert np.array_equal(estimate.f_c, estimate.observed)
    assert (state.tare, state.report) == (Tare.NONE, "")
    assert not np.any(state.change)


@given(vectors(0.8))
@settings(max_examples=20)
def test_g8_zeroing_with_the_hanging_handle_takes_the_whole_bias(lie: Array) -> None:
    """What is left is the handle's weight: then any pull is read as it is."""
    state = zeroed(lie)
    assert state.tare is Tare.PASSED
    assert last(state, sample(FREE, lie), 0.1)[1].f_c == pytest.approx(FREE, abs=1e-4)
    pull = np.array([0.9, 0.0, 1.2])  # along the cable, so that nothing of it is taken for bias
    assert last(state, sample(pull, lie), 1.0, PULLED)[1].f_c == pytest.approx(pull, abs=1e-3)


def test_g8_by_its_numbers() -> None:
    state = zeroed(G8)
    assert state.zero == pytest.approx(G8, abs=1e-5)
    assert last(state, sample(FREE, G8), 0.1)[1].f_c == pytest.approx(FREE, abs=1e-5)


@given(FORCES, SMALL, SMALL, st.sampled_from([HANGING, PULLED, SLACK, HIDDEN]))
@settings(max_examples=30)
def test_force_is_observed_less_zero_less_change(f_c: Array, zero: Array, change: Array, cable: Geometry) -> None:
    state = estimator.initial()._replace(zero=zero, change=change, tare=Tare.PASSED)
    for after, estimate in run(state, sample(f_c), 0.3, cable):
        assert estimate.f_c == pytest.approx(estimate.observed - zero - after.change, abs=1e-12)
        assert np.array_equal(after.zero, zero)


def test_zeroing_runs_for_its_time_and_then_has_a_result() -> None:
    x = sample(FREE, G8)
    told = [state.tare for state, _ in run(settled(x), x, 1.3, zero=True)]
    running = told.count(Tare.RUNNING)
    assert told == [Tare.RUNNING] * running + [Tare.PASSED] * (len(told) - running)
    assert running * DT == pytest.approx(BIAS.tare_s, abs=2 * DT)


def test_a_result_stays_when_the_wish_is_over_and_however_long_it_lasts() -> None:
    x = sample(FREE, G8)
    state = zeroed(G8)
    for zero in (True, False):
        state, _ = last(state, sample(FREE, 3.0 * G8), 2.0, HIDDEN, zero=zero)
        assert state.tare is Tare.PASSED
        assert state.zero == pytest.approx(G8, abs=1e-5)
    assert last(state, x, 1.0, HIDDEN)[1].f_c == pytest.approx(FREE, abs=1e-4)


@pytest.mark.parametrize("before", [Tare.NONE, Tare.PASSED])
def test_broken_off_it_has_no_result_and_changes_nothing(before: Tare) -> None:
    x = sample(FREE, G8)
    state = last(zeroed(), sample(FREE), DT)[0] if before is Tare.PASSED else settled(x)
    assert state.tare is before
    broken, _ = last(last(state, x, 0.6, zero=True)[0], x, 0.1)
    assert broken.tare is Tare.NONE
    assert np.array_equal(broken.zero, state.zero)
    again, _ = last(broken, x, 0.6, zero=True)
    assert again.tare is Tare.RUNNING, "half a second of an earlier try must not count"


def swinging(force_N: float) -> Iterator[Sample]:
    """A handle that swings wildly, or a vehicle that does not hover."""
    for n in range(round(1.3 / DT)):
        yield sample(FREE + [force_N * np.sin(2 * np.pi * n * DT), 0.0, 0.0])


def test_a_swing_fails_it_with_the_reason_and_keeps_the_last_good_result() -> None:
    state = zeroed(G8)
    for x in swinging(1.0):
        state, _ = estimator.step(state, x, HANGING, True, REST_M, OBSERVER, BIAS)
    assert state.tare is Tare.PASSED, "the wish never ended: no second zeroing"
    state, _ = last(state, sample(FREE, G8), 0.5)
    for x in swinging(1.0):
        state, _ = estimator.step(state, x, HANGING, True, REST_M, OBSERVER, BIAS)
    assert state.tare is Tare.FAILED
    assert "tare_std_max_N" in state.report
    assert state.zero == pytest.approx(G8, abs=1e-5)


def test_a_bias_beyond_belief_fails_it_and_a_new_wish_may_pass() -> None:
    wrong = sample(FREE, np.array([0.0, 0.0, 2.0]))
    state, _ = last(settled(wrong), wrong, 1.2, zero=True)
    assert state.tare is Tare.FAILED
    assert "tare_bias_max_N" in state.report
    assert not np.any(state.zero)
    right = sample(FREE, G8)
    state, _ = last(state, right, 1.0)
    assert state.tare is Tare.FAILED
    state, _ = last(state, right, 1.2, zero=True)
    assert (state.tare, state.report) == (Tare.PASSED, "")
    assert state.zero == pytest.approx(G8, abs=1e-3)


def test_zeroing_again_forgets_the_change_since() -> None:
    drifted, _ = last(zeroed(), sample(np.array([0.6, 0.3, 0.8])), 8.0, PULLED)
    assert norm(drifted.change) > 0.2
    x = sample(FREE, G8)
    state, estimate = last(last(drifted, x, 1.0)[0], x, 1.2, zero=True)
    assert norm(state.change) < 0.01
    assert estimate.f_c == pytest.approx(FREE, abs=0.01)


@given(vectors(0.4))
@settings(max_examples=15)
def test_what_is_across_the_cable_is_watched_away_and_what_is_along_it_stays(drift: Array) -> None:
    l_hat = PULLED.l_c / norm(PULLED.l_c)
    pull = 1.5 * l_hat
    state, estimate = last(zeroed(), sample(pull, drift), 16.0, PULLED)
    assert estimate.f_c == pytest.approx(pull + (drift @ l_hat) * l_hat, abs=2e-3)
    assert state.change == pytest.approx(drift - (drift @ l_hat) * l_hat, abs=2e-3)


def test_held_and_slack_all_of_it_is_bias() -> None:
    state, estimate = last(zeroed(), sample(np.zeros(3), G8), 16.0, SLACK)
    assert state.change == pytest.approx(G8, abs=1e-3)
    assert norm(estimate.f_c) < 1e-3


@pytest.mark.parametrize("cable", [HIDDEN, SLACK._replace(held=False)], ids=["hidden", "dropped"])
def test_nothing_is_learnt_from_a_handle_that_is_hidden_or_lies_about(cable: Geometry) -> None:
    state, _ = last(zeroed(), sample(np.array([0.6, 0.3, 0.8])), 2.0, PULLED)
    assert norm(state.change) > 0.05
    frozen, _ = last(state, sample(FREE, 3.0 * G8), 10.0, cable)
    assert np.array_equal(frozen.change, state.change)


def test_never_zeroed_nothing_is_watched() -> None:
    assert not np.any(last(estimator.initial(), sample(FREE, G8), 10.0, PULLED)[0].change)


@pytest.mark.parametrize(("cable", "slack_m"), [(HANGING, 0.0), (SLACK, 1.0 - np.sqrt(0.72)), (HIDDEN, -1.0)])
def test_slack_by_motion_capture_or_unknown(cable: Geometry, slack_m: float) -> None:
    """-1 where the handle is hidden: never mistaken for a slack cable."""
    assert last(estimator.initial(), sample(FREE), 0.02, cable)[1].slack_m == pytest.approx(slack_m)


@pytest.mark.parametrize(("force_N", "taut"), [(0.0, False), (0.14, False), (0.16, True), (1.8, True)])
def test_taut_is_more_than_half_the_handles_weight(force_N: float, taut: bool) -> None:
    assert last(zeroed(), sample(np.array([0.0, 0.0, force_N])), 1.0, HIDDEN)[1].taut == taut
