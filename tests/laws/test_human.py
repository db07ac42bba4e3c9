"""The person: the paper's mass and damper, and a will that is data."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.simulator import human
from services.simulator.human import Event, Human, HumanState, Kind

P = Human(
    m_H_kg=5.0,
    b_H_Ns_per_m=8.0,
    hand_height_m=1.0,
    head_height_m=1.65,
    head_behind_hand_m=0.4,
    head_beside_hand_m=0.0,
    turning_time_s=0.5,
    b_stop_Ns_per_m=200.0,
)
AHEAD = np.array([1.0, 0.0, 0.0])
NONE = np.zeros(3)
forces = st.tuples(*[st.floats(-5.0, 5.0)] * 3).map(np.array)


def standing(at=(0.0, 0.0, 1.0), v=(0.0, 0.0, 0.0)) -> HumanState:
    return HumanState(np.array(at), np.array(v), AHEAD)


def walk(state: HumanState, f_c, seconds: float, script=(), dt: float = 0.01) -> HumanState:
    for i in range(round(seconds / dt)):
        state = human.step(state, f_c, human.u_H(i * dt, state, script, P), dt, P)
    return state


@given(forces, st.floats(0.05, 3.0))
def test_one_long_step_is_as_many_short_ones(f_c, seconds):
    start = standing(v=(0.3, -0.2, 0.0))
    once = human.step(start, f_c, NONE, seconds, P)
    many = start
    for _ in range(50):
        many = human.step(many, f_c, NONE, seconds / 50, P)
    assert once.p_H_W == pytest.approx(many.p_H_W, abs=1e-9)
    assert once.v_H_W == pytest.approx(many.v_H_W, abs=1e-9)


@given(forces)
def test_the_step_solves_the_papers_equation(f_c):
    start, dt = standing(v=(0.4, 0.1, 0.0)), 1e-6
    acceleration = (human.step(start, f_c, NONE, dt, P).v_H_W - start.v_H_W) / dt
    expected = (f_c * [1, 1, 0] - P.b_H_Ns_per_m * start.v_H_W) / P.m_H_kg
    assert acceleration == pytest.approx(expected, abs=1e-4)


@given(forces)
def test_the_hand_stays_in_its_plane_and_ends_at_the_speed_the_force_pays_for(f_c):
    end = walk(standing(), f_c, 10.0, dt=0.1)
    assert end.p_H_W[2] == 1.0
    assert end.v_H_W == pytest.approx(f_c * [1, 1, 0] / P.b_H_Ns_per_m, abs=1e-5)


@given(forces)
def test_without_force_the_person_only_loses_energy(f_c):
    before = standing(v=tuple(f_c * [1, 1, 0]))
    after = human.step(before, NONE, NONE, 0.01, P)
    assert after.v_H_W @ after.v_H_W <= before.v_H_W @ before.v_H_W


def test_a_stop_holds_the_person_against_the_pull():
    script = (Event(kind=Kind.STOP, start_s=5.0, duration_s=3.0),)
    pull = np.array([1.5, 0.0, 1.0])
    assert walk(standing(), pull, 5.0, script).v_H_W[0] == pytest.approx(1.5 / 8.0, rel=0.01)
    assert walk(standing(), pull, 6.0, script).v_H_W[0] < 0.01
    assert walk(standing(), pull, 13.0, script).v_H_W[0] == pytest.approx(1.5 / 8.0, rel=0.01)


def test_a_script_adds_up_what_goes_on_at_the_time_and_knows_no_height():
    script = (
        Event(kind=Kind.PUSH, start_s=1.0, duration_s=1.0, force_W_N=(0.0, 2.0, 9.0)),
        Event(kind=Kind.WALK_AWAY, start_s=1.5, force_W_N=(-4.0, 0.0, 0.0)),
    )
    seen = [human.u_H(t, standing(), script, P).tolist() for t in (0.5, 1.0, 1.7, 3.0)]
    assert seen == [[0, 0, 0], [0, 2, 0], [-4, 2, 0], [-4, 0, 0]]


def test_letting_go_is_an_event():
    script = (Event(kind=Kind.LET_GO, start_s=2.0, duration_s=1.0),)
    assert [human.lets_go(t, script) for t in (1.9, 2.0, 2.9, 3.0)] == [False, True, True, False]


@pytest.mark.parametrize(
    ("event", "message"),
    [
        ({"kind": Kind.STOP, "start_s": 0.0, "duration_s": 0.0}, "duration_s = 0.0"),
        ({"kind": Kind.PUSH, "start_s": 0.0, "force_W_N": (0.0, 0.0, 3.0)}, "horizontal"),
    ],
)
def test_an_event_that_cannot_be_meant_is_refused(event, message):
    with pytest.raises(ValueError, match=message):
        Event(**event)


def test_the_head_is_behind_the_hand_wherever_the_person_walks():
    for angle in (0.0, 2.0, math.pi, -1.0):
        way = np.array([math.cos(angle), math.sin(angle), 0.0])
        end = walk(standing(), 3.0 * way, 8.0)
        head = human.head(end.p_H_W, end.facing_W, P)
        assert (head - end.p_H_W) == pytest.approx([*(-0.4 * way[:2]), 0.65], abs=0.02)


def test_a_crowd_walks_as_each_would_alone():
    v = np.array([[0.5, 0.0, 0.0], [-0.2, 0.3, 0.0]])
    crowd = HumanState(np.ones((2, 3)), v, np.tile(AHEAD, (2, 1)))
    together = human.step(crowd, v, -v, 0.1, P)
    for i in range(2):
        alone = human.step(HumanState(np.ones(3), v[i], AHEAD), v[i], -v[i], 0.1, P)
        for a, b in zip(alone, together, strict=True):
            assert a == pytest.approx(b[i])
