"""A handle that hangs higher than the cable is long, and one that a hand lifts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.config import load
from services.faults.rows.people import CAUGHT_M
from services.safety_supervisor.caught import LIFTED_MPS, MEAN_S, State, step
from services.safety_supervisor.rules import CABLE_SHORT_M

CONFIG = load("demo")
L, W, DT = CONFIG.cable.rest_length_m, CONFIG.px4_bridge.flight.handle_weight_N, 0.01
STILL = np.zeros(3)


def after(seconds, length_m, f_z_N, closing_mps=0.0, state=None):
    """What is known after so long of the same; `f_z_N` is a number or draws one for each tick."""
    state, caught_m = state or State(), 0.0
    for _ in range(round(seconds / DT)):
        f_c = np.array([0.0, 0.0, f_z_N() if callable(f_z_N) else f_z_N])
        l_c, dl_c = np.array([0.0, 0.0, length_m]), np.array([0.0, 0.0, -closing_mps])
        state, caught_m = step(state, l_c, dl_c, f_c, DT, L, W)
    return state, caught_m


@given(st.floats(CABLE_SHORT_M, 0.5))
def test_what_hangs_too_high_is_caught_within_its_mean(short_m):
    _, caught_m = after(MEAN_S, L - short_m, W)
    assert caught_m == pytest.approx(short_m)


@given(st.floats(0.0, 0.02))
def test_a_cable_that_hangs_as_it_should_is_not_short(stretch_m):
    assert after(1.0, L + stretch_m, W)[1] == 0.0


@given(st.floats(0.0, 0.6), st.floats(0.0, 0.3))
def test_a_hand_takes_the_weight_of_what_it_lifts(lifted_m, bias):
    """Whatever it hung before; and a bias of a third of the weight hides nothing."""
    hung, _ = after(2.0, L, W * (1.0 + bias))
    _, caught_m = after(1.0, L - lifted_m, W * bias, state=hung)
    assert caught_m == 0.0


def test_a_hand_that_comes_up_is_no_caught_cable_even_before_the_mean_has_followed():
    hung, _ = after(2.0, L, W)
    assert after(DT, L - CAUGHT_M, 0.0, closing_mps=1.01 * LIFTED_MPS, state=hung)[1] == 0.0
    assert after(DT, L - CAUGHT_M, 0.0, closing_mps=0.99 * LIFTED_MPS, state=hung)[1] > 0.0


def test_the_noise_of_a_vehicle_that_accelerates_hides_nothing():
    """By 1 N each way, as when it is pushed ahead."""
    draw = np.random.default_rng(1)
    _, caught_m = after(2.0, L - CAUGHT_M, lambda: W + draw.normal(0.0, 0.5))
    assert caught_m == pytest.approx(CAUGHT_M)


def test_many_are_one_after_the_other():
    draw = np.random.default_rng(2)
    l_c, dl_c, f_c = (
        draw.normal(0.0, 0.4, (5, 3)) + [0.0, 0.0, 0.8],
        draw.normal(0.0, 0.3, (5, 3)),
        draw.normal(W, 0.3, (5, 3)),
    )
    carried = draw.normal(W, 0.1, 5)
    state, caught_m = step(State(carried), l_c, dl_c, f_c, DT, L, W)
    for i in range(5):
        one, one_m = step(State(float(carried[i])), l_c[i], dl_c[i], f_c[i], DT, L, W)
        assert (one.carried_N, one_m) == (state.carried_N[i], caught_m[i])
