"""A handle that is seen where a taut cable does not lead is not believed, until it is seen where the cable leads again."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.tracker import filtering, hand
from services.tracker.filtering import Filter
from services.tracker.hand import Led
from tests.laws.strategies import vectors

P = Filter(tau_s=0.03, gate_m=0.05, gate_mps=3.0, lost_s=0.3, settle_s=0.1)
DT = 1.0 / 60.0
HAND = np.array([-1.0, -0.5, 1.0])
MISLED = np.array([0.5, 0.0, 0.0])
LOST = round(P.lost_s / DT) + 1
"""Frames after which what is kept out is lost."""
ALONG = np.array([0.6, 0.0, 0.8])
YIELDS_M = 0.11
LED = Led(HAND, ALONG, YIELDS_M)
Frame = tuple[np.ndarray, Led | None]
"""Where the handle is seen, and where the cable leads."""


def flown(
    frames: list[Frame], aloft: bool = True, state: hand.State | None = None
) -> tuple[hand.State, list[filtering.Output]]:
    """What is known of the hand after each frame."""
    state, known = state or hand.start(), []
    for z, led in frames:
        state, found = hand.step(state, z, True, led, aloft, DT, P)
        known.append(found)
    return state, known


def walk(n: int, shift: np.ndarray, taut: bool = True) -> list[Frame]:
    """`n` frames of a hand that stands, seen `shift` away from where the cable leads."""
    return [(HAND + shift, LED if taut else None)] * n


@pytest.mark.parametrize("shift", [MISLED, -MISLED, MISLED[[1, 0, 2]], MISLED[[1, 2, 0]]])
def test_a_jump_from_a_taut_cable_is_never_believed(shift):
    _, known = flown(walk(60, 0.0 * shift) + walk(300, shift))
    assert all(found.valid for found in known[10 : 60 + LOST - 2])  # coasts, as over any jump
    assert not any(found.valid for found in known[60 + LOST :])
    assert all(found.p == pytest.approx(HAND, abs=1e-6) for found in known[10 : 60 + LOST])


def test_a_jump_while_the_cable_is_slack_is_found_out_when_it_is_taut():
    _, known = flown(walk(60, 0.0 * MISLED, taut=False) + walk(60, MISLED, taut=False) + walk(60, MISLED))
    assert known[115].valid  # nothing contradicts it
    assert known[120 + LOST - 2].valid
    assert not any(found.valid for found in known[120 + LOST :])


def test_a_handle_that_creeps_away_is_doubted_too():
    """At no time a jump: 0.25 m/s."""
    assert believed_m(np.array([0.0, 1.0, 0.0])) == pytest.approx(hand.APART_M + 0.25 * P.lost_s, abs=0.01)


@pytest.mark.parametrize(("way", "from_m"), [(ALONG, hand.SHORT_M), (-ALONG, hand.LONG_M)])
def test_along_a_taut_cable_it_is_doubted_sooner(way, from_m):
    """A hand that comes nearer slackens it, and none goes further than it is long."""
    assert believed_m(way) == pytest.approx(from_m + 0.25 * 0.5 * P.lost_s, abs=0.01)


def test_a_hand_that_comes_as_fast_as_hands_do_is_believed():
    """While it passes, the cable goes slack and the force estimate is late; then the vehicle gives way and it is wrong."""
    assert believed_m(ALONG, 0.7) > YIELDS_M + 0.1


def believed_m(way: np.ndarray, speed_mps: float = 0.25) -> float:
    """How far a handle gets that is seen creeping away."""
    frames: list[Frame] = [(HAND + speed_mps * n * DT * way, LED) for n in range(240)]
    _, known = flown(frames)
    last = max(n for n, found in enumerate(known) if found.valid)
    return float(np.linalg.norm(frames[last][0] - HAND))


def test_a_slack_cable_leaves_a_doubt_as_it_is():
    state, known = flown(walk(60, 0.0 * MISLED) + walk(60, MISLED) + walk(600, 0.0 * MISLED, taut=False))
    assert state.doubted
    assert not known[-1].valid


def test_a_doubt_ends_when_both_agree_for_as_long_as_they_differed_and_not_before():
    before, _ = flown(walk(60, 0.0 * MISLED) + walk(300, MISLED))
    briefly, _ = flown(walk(5, 0.0 * MISLED), state=before)
    again, _ = flown(walk(60, MISLED), state=briefly)
    assert again.doubted
    after, known = flown(walk(60, 0.0 * MISLED), state=before)
    assert not after.doubted
    assert known[-1].valid
    assert known[-1].p == pytest.approx(HAND, abs=1e-6)
    first = next(n for n, found in enumerate(known) if found.valid)
    assert first * DT == pytest.approx(2.0 * P.lost_s + P.settle_s, abs=3 * DT)


def test_on_the_ground_there_is_no_doubt():
    before, _ = flown(walk(60, 0.0 * MISLED) + walk(60, MISLED))
    _, known = flown(walk(60, MISLED), aloft=False, state=before)
    assert known[-1].valid


@given(st.lists(st.tuples(vectors(2.0), st.booleans()), max_size=60))
def test_without_a_taut_cable_it_is_the_filter(frames):
    state, plain = hand.start(), filtering.start()
    for z, measured in frames:
        state, found = hand.step(state, z, measured, None, True, DT, P)
        plain, expected = filtering.step(plain, z, measured, DT, P)
        assert np.array_equal(found.p, expected.p)
        assert np.array_equal(found.v, expected.v)
        assert (found.sample, found.valid) == (expected.sample, expected.valid)


@given(st.lists(st.tuples(vectors(0.16), st.floats(-0.09, 0.049), vectors(0.04)), min_size=30, max_size=90))
def test_what_both_ends_of_a_taut_cable_differ_by_in_a_walk_is_no_doubt(errors):
    """However it comes about: fewer than 0.3 m are none, nor are a few cm along it."""
    frames: list[Frame] = []
    for error, along_m, walked in errors:
        away = error + (along_m - error @ ALONG) * ALONG
        frames.append((HAND + walked, Led(HAND + walked - away, ALONG, YIELDS_M)))
    state, _ = flown(frames)
    assert not state.doubted
