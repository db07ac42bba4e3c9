"""The simulated subject through the phases of the paper's experiment."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.physics import norm
from services.simulator import subject
from services.simulator.human import Human
from services.simulator.subject import Phase, Subject, SubjectInput

BODY = Human(
    m_H_kg=5.0,
    b_H_Ns_per_m=8.0,
    hand_height_m=1.0,
    head_height_m=1.65,
    head_behind_hand_m=0.4,
    head_beside_hand_m=0.0,
    turning_time_s=0.5,
    b_stop_Ns_per_m=200.0,
)
P = Subject(
    reach_speed_mps=0.5,
    reach_rate_per_s=2.0,
    hand_lag_s=0.1,
    grasp_distance_m=0.02,
    retreat_distance_m=1.5,
    let_go_force_N=0.3,
    let_go_after_s=2.0,
    let_go_walked_m=1.0,
)
DT = 0.01
AHEAD = np.array([1.0, 0.0, 0.0])
HANDLE = np.array([0.0, 0.0, 0.9])
START = subject.waiting(np.array([-1.5, 0.3, 0.8]), AHEAD)
PULL = np.array([1.5, 0.0, 1.0])
UP = np.array([0.0, 0.0, 1.0])


def run(state, seconds, **said):
    outs = []
    for _ in range(round(seconds / DT)):
        state = subject.step(state, SubjectInput(HANDLE, UP)._replace(**said), DT, P, BODY)
        outs.append(subject.report(state, BODY))
    return state, outs


def holding():
    return run(START, 10.0, told_to_take=True)[0]


def test_nobody_moves_before_being_told():
    _, outs = run(START, 3.0)
    assert outs[-1].phase is Phase.WAITING
    assert outs[-1].p_hand_W == pytest.approx(START.person.p_H_W)
    assert not outs[-1].holding


def test_told_the_subject_takes_the_handle_and_brings_it_to_height_smoothly():
    _, outs = run(START, 10.0, told_to_take=True)
    assert outs[-1].phase is Phase.HOLDING
    assert outs[-1].p_hand_W == pytest.approx([0.0, 0.0, 1.0], abs=0.01)
    speeds = np.array([norm(o.v_hand_W) for o in outs])
    assert speeds.max() <= P.reach_speed_mps + 1e-9
    assert np.abs(np.diff([o.v_hand_W for o in outs], axis=0)).max() / DT < 6.0


def test_the_hand_closes_where_the_handle_is():
    _, outs = run(START, 10.0, told_to_take=True)
    first = next(o for o in outs if o.holding)
    assert first.p_hand_W == pytest.approx(HANDLE, abs=0.01)


def test_a_word_taken_back_before_the_grasp_sends_the_subject_away():
    state, _ = run(START, 1.0, told_to_take=True)
    state, outs = run(state, 0.1)
    assert outs[-1].phase is Phase.LEAVING


def test_while_holding_the_hand_is_the_papers_person():
    _, outs = run(holding(), 6.0, told_to_take=True, f_c_W=PULL)
    assert outs[-1].v_hand_W[0] == pytest.approx(1.5 / 8.0, rel=0.01)
    assert outs[-1].p_hand_W[2] == pytest.approx(1.0, abs=0.01)
    assert outs[-1].p_head_W == pytest.approx(outs[-1].p_hand_W + [-0.4, 0.0, 0.65], abs=0.01)


def test_the_subject_lets_go_when_nothing_pulls_any_more_after_a_walk():
    state, outs = run(holding(), 10.0, told_to_take=True, f_c_W=PULL)
    assert outs[-1].holding
    state, outs = run(state, 1.9, told_to_take=True)
    assert outs[-1].holding
    state, outs = run(state, 0.2, told_to_take=True)
    assert not outs[-1].holding
    where = outs[-1].p_hand_W
    _, outs = run(state, 8.0, told_to_take=True)
    assert outs[-1].phase is Phase.LEAVING
    assert norm(outs[-1].p_hand_W - where) == pytest.approx(P.retreat_distance_m, abs=0.05)


def test_without_a_walk_the_missing_pull_means_nothing():
    _, outs = run(holding(), 10.0, told_to_take=True)
    assert all(o.holding for o in outs)


@pytest.mark.parametrize("word", ["told_to_let_go", "wants_to_let_go"])
def test_told_or_willing_the_subject_lets_go_at_once(word):
    _, outs = run(holding(), 2 * DT, told_to_take=True, f_c_W=PULL, **{word: True})
    assert not outs[0].holding


def test_to_take_the_handle_again_the_word_must_be_new():
    state, _ = run(holding(), 0.1, told_to_take=True, told_to_let_go=True)
    state, outs = run(state, 5.0, told_to_take=True)
    assert outs[-1].phase is Phase.LEAVING
    state, _ = run(state, 0.1)
    _, outs = run(state, 10.0, told_to_take=True)
    assert outs[-1].phase is Phase.HOLDING


@settings(deadline=None, max_examples=50)
@given(st.lists(st.tuples(st.booleans(), st.booleans(), st.floats(-3, 3), st.floats(0.05, 1.0)), max_size=12))
def test_whatever_is_said_the_hand_moves_without_jumps(said):
    state, last = START, START.person.p_H_W
    for take, let_go, pull, seconds in said:
        f_c = np.array([pull, 0.0, 1.0])
        state, outs = run(state, seconds, told_to_take=take, told_to_let_go=let_go, f_c_W=f_c)
        for out in outs:
            assert norm(out.p_hand_W - last) <= 1.0 * DT + P.grasp_distance_m
            last = out.p_hand_W


def test_who_pulls_down_is_held_up_by_the_cable_until_the_arm_is_stretched():
    """humanModel upright: with 15 N against 7 N the hand sinks at 8 N / b_H in the end, and no further than the arm goes."""
    seven_up = np.array([0.0, 0.0, 7.0])
    _, outs = run(holding(), 10.0, f_c_W=seven_up, down_N=15.0, down_m=5.0)
    fastest = min(out.v_hand_W[2] for out in outs)
    assert fastest == pytest.approx(-8.0 / BODY.b_H_Ns_per_m, abs=0.02)
    _, outs = run(holding(), 10.0, f_c_W=seven_up, down_N=15.0, down_m=0.6)
    assert outs[-1].p_hand_W[2] == pytest.approx(BODY.hand_height_m - 0.6)
    assert outs[-1].v_hand_W[2] == 0.0
    _, outs = run(holding(), 1.0, f_c_W=np.array([0.0, 0.0, 20.0]), down_N=15.0, down_m=0.6)
    assert outs[-1].p_hand_W[2] > BODY.hand_height_m + 0.1  # a stronger cable lifts it
