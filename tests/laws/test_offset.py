"""Comparing clocks: the bound holds whatever the radio does to question and answer."""

from hypothesis import given
from hypothesis import strategies as st

from services.gateway.offset import KEEP, Answer, estimate, step

WAY_ns = st.integers(0, 2_000_000_000)
DRIFT_per_s = 1e-4


def exchange(sent_ns: int, there_ns: int, back_ns: int, theta_ns: int) -> Answer:
    return Answer(sent_ns, sent_ns + there_ns + theta_ns, sent_ns + there_ns + back_ns)


@given(theta=st.integers(-(10**15), 10**15), ways=st.lists(st.tuples(WAY_ns, WAY_ns), min_size=1, max_size=80))
def test_the_truth_lies_within_the_uncertainty(theta, ways):
    answers, now_ns = (), 0
    for there, back in ways:
        answer = exchange(now_ns, there, back, theta)
        answers = step(answers, answer)
        now_ns = answer.t_3_ns + 500_000_000
        found = estimate(answers, now_ns, DRIFT_per_s)
        assert found is not None
        assert abs(found.theta_ns - theta) <= found.uncertainty_ns + 1
    assert len(answers) <= KEEP


@given(theta=st.integers(-(10**15), 10**15), ppm=st.integers(-100, 100), idle_s=st.integers(0, 3600))
def test_it_goes_on_holding_while_the_radio_is_gone_and_the_clocks_drift(theta, ppm, idle_s):
    answers = step((), exchange(0, 20_000_000, 25_000_000, theta))
    now_ns = 45_000_000 + idle_s * 1_000_000_000
    drifted_ns = theta + ppm * 1e-6 * (now_ns - 45_000_000)
    found = estimate(answers, now_ns, DRIFT_per_s)
    assert found is not None
    assert abs(found.theta_ns - drifted_ns) <= found.uncertainty_ns + 1


def test_the_quickest_answer_counts_until_it_is_old():
    quick = exchange(0, 1_000_000, 1_000_000, 7)
    slow = exchange(10_000_000, 60_000_000, 20_000_000, 7)
    found = estimate((quick, slow), 100_000_000, DRIFT_per_s)
    assert found is not None
    assert found.theta_ns == 7
    assert estimate((), 0, DRIFT_per_s) is None
    late_ns = 10**15
    late = exchange(late_ns, 60_000_000, 60_000_000, 7)
    found = estimate((quick, late), late_ns + 120_000_000, DRIFT_per_s)
    assert found is not None
    assert found.uncertainty_ns == 60_000_000


def test_an_answer_from_before_its_question_is_not_believed():
    assert step((), Answer(10, 5, 9)) == ()
