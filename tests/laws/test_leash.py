"""Round the hand: never nearer than the propellers allow, never so far that a slack cable pulls."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from schemas.safety import Permit
from schemas.vehicle import SetpointKind
from services.physics import norm
from services.px4_bridge import flight, leash
from services.px4_bridge.leash import Hand
from tests.laws.flown import DT, HAND, ZERO, P, after, guided, sight
from tests.laws.strategies import vectors

NEAR, FAR = P.flight.hand_clear_m, P.flight.rest_length_m - P.flight.ease_slack_m
STILL = Hand(HAND, ZERO)


@given(vectors(2.0))
def test_between_moves_no_further_than_it_must(p):
    moved = leash.between(p, ZERO, NEAR, FAR)
    assert NEAR - 1e-9 <= norm(moved) <= FAR + 1e-9
    wanted = 0.0 if NEAR <= norm(p) <= FAR else min(abs(norm(p) - NEAR), abs(norm(p) - FAR))
    assert norm(moved - p) == pytest.approx(wanted, abs=1e-6)


@given(vectors(1.0), vectors(1.0), vectors(2.0))
def test_a_hand_only_pushes(p, v, v_H):
    """Away from itself, at most at its own speed and a little more; and not at all from further away."""
    assume(norm(p) > 1e-3)
    moved, faster = leash.pushed(p, v, Hand(ZERO, v_H), DT, NEAR)
    away = p / norm(p)
    assert (faster - v) @ away >= -1e-9
    assert norm(np.cross(faster - v, away)) < 1e-9
    assert norm(moved - p) <= (leash.FASTEST_MPS + norm(v)) * DT + 1e-9
    if norm(p) >= NEAR:
        assert np.array_equal(moved, p)


@pytest.mark.parametrize("kind", [Permit.WAIT, Permit.GUIDE, Permit.EASE, Permit.HOLD])
@pytest.mark.parametrize("fresh", [True, False])
def test_a_hand_that_rises_pushes_the_reference_ahead_of_it(kind, fresh):
    """At 0.7 m/s, in every way of flying in which somebody may be under it."""
    state, hand = flight.initial(HAND + [0.0, 0.0, 1.0], P), HAND.copy()
    nearest = np.inf
    for _ in range(round(0.8 / DT)):
        hand = hand + [0.0, 0.0, 0.7 * DT]
        x = sight(kind, fresh=fresh)._replace(goal=HAND + [0.0, 0.0, 1.0], hand=Hand(hand, np.array([0.0, 0.0, 0.7])))
        state, _ = flight.step(state, x, DT, P)
        nearest = min(nearest, float(norm(state.filter.p - hand)))
    assert nearest > NEAR - 0.02


def test_where_the_cable_pulls_a_hand_seen_near_is_not_believed():
    state = after(guided(), sight(Permit.EASE, np.array([1.5, 0.0, 1.0])), DT)
    near = sight(Permit.EASE, np.array([1.5, 0.0, 1.0]))._replace(hand=Hand(state.filter.p - [0.0, 0.0, 0.3], ZERO))
    moved, _ = flight.step(state, near, DT, P)
    assert norm(moved.filter.v) < 0.1


@pytest.mark.parametrize("permit", [Permit.EASE, Permit.HOLD])
@given(heading=st.floats(-np.pi, np.pi), speed=st.floats(0.0, 0.6))
@settings(max_examples=30)  # flights of 6 s
def test_backed_off_the_cable_stays_slack_however_the_person_walks(permit, heading, speed):
    """Only as long as it takes to follow is it shorter of slack; at rest it has all of it."""
    state, hand = guided(ZERO), HAND.copy()
    step = speed * DT * np.array([np.cos(heading), np.sin(heading), 0.0])
    for _ in range(round(6.0 / DT)):
        hand = hand + step
        state, output = flight.step(state, sight(permit)._replace(hand=Hand(hand, step / DT)), DT, P)
        assert norm(output.u_A[:2]) <= 0.2 + 1e-9
    assert NEAR - 0.02 < norm(state.hold - hand) < FAR + 1e-6
    if permit is Permit.HOLD:
        assert norm(state.filter.p - hand) < FAR + 0.01


def test_hold_stands_and_asks_nothing_of_the_force():
    felt = after(guided(), sight(Permit.HOLD, np.array([9.0, 0.0, 3.0]))._replace(hand=STILL), 4.0)
    assert felt.kind is SetpointKind.HOLD
    assert norm(felt.filter.v) < 2e-3
    assert norm(felt.filter.p - HAND) == pytest.approx(FAR, abs=0.01)
    assert not np.any(felt.u_A)
    assert felt.feed_forward == 0.0


def test_a_vehicle_sent_away_does_not_drag_who_holds_on():
    state = after(
        flight.initial(HAND + [0.0, 0.0, 0.95], P),
        sight(Permit.POSITION)._replace(goal=HAND + [5.0, 0.0, 0.5], hand=STILL),
        12.0,
    )
    assert norm(state.filter.p - HAND) < FAR + 0.01
    gone = after(state, sight(Permit.POSITION, held=False)._replace(goal=HAND + [3.0, 0.0, 0.5], hand=STILL), 12.0)
    assert norm(gone.filter.p - HAND) > 2.5
