"""What the bridge may do and asks for: the worth of an old word, and orders by their tables."""

from itertools import pairwise, product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.safety import Permit, Phase
from schemas.vehicle import FlightMode
from services.px4_bridge.orders import AWAY_S, STREAM_FIRST_S, Flown, Order, flown, kills, next_order, streams
from services.px4_bridge.permits import effective

# permits.effective

SILENT_S, LOST_S = 0.2, 3.0
AGES = st.one_of(st.floats(0.0, 10.0), st.just(float("inf")))
LESS = [Permit.GUIDE, Permit.WAIT, Permit.POSITION]  # what a fresh word may allow, and an old one not


@pytest.mark.parametrize("permit", list(Permit))
@pytest.mark.parametrize("age_s", [0.0, 0.2, 0.21, 2.9, 3.0, 3.1, float("inf")])
def test_what_a_word_is_worth_when_it_grows_old(permit: Permit, age_s: float) -> None:
    if permit in (Permit.NONE, Permit.LAND, Permit.KILL) or age_s <= SILENT_S:
        expected = permit
    else:
        expected = Permit.EASE if age_s <= LOST_S else Permit.LAND
    assert effective(permit, age_s, SILENT_S, LOST_S) is expected


def test_without_a_word_nothing_is_permitted() -> None:
    assert effective(None, float("inf"), SILENT_S, LOST_S) is Permit.NONE
    assert effective(None, 0.0, SILENT_S, LOST_S) is Permit.NONE


@given(st.sampled_from([*LESS, Permit.EASE, Permit.HOLD, Permit.LAND]), st.lists(AGES, min_size=2).map(sorted))
def test_age_only_takes_away(permit: Permit, ages: list[float]) -> None:
    order = [*LESS, Permit.HOLD, Permit.EASE, Permit.LAND]  # an old word to hold gives way as well
    ranks = [max(order.index(effective(permit, age, SILENT_S, LOST_S)), order.index(Permit.EASE) - 1) for age in ages]
    assert all(a <= b for a, b in pairwise(ranks))


# orders.next_order, orders.streams

EVERYTHING = list(product(Permit, Phase, (False, True), FlightMode))
LANDS = (FlightMode.LAND, FlightMode.DESCEND)


@pytest.mark.parametrize("streaming_s", [0.0, STREAM_FIRST_S, 100.0])
def test_it_arms_and_takes_over_only_in_the_take_off(streaming_s: float) -> None:
    for permit, phase, armed, mode in EVERYTHING:
        order = next_order(permit, phase, armed, mode, streaming_s)
        if order in (Order.ARM, Order.OFFBOARD):
            assert (permit, phase) == (Permit.POSITION, Phase.TAKEOFF)
            assert streaming_s >= STREAM_FIRST_S
        if order is Order.ARM:
            assert mode is FlightMode.OFFBOARD
            assert not armed
        assert (order is Order.LAND) == (permit is Permit.LAND and armed and mode not in LANDS)


def test_a_take_off_is_stream_then_offboard_then_arm_then_nothing() -> None:
    def asked(armed: bool, mode: FlightMode, streaming_s: float) -> Order:
        return next_order(Permit.POSITION, Phase.TAKEOFF, armed, mode, streaming_s)

    assert asked(False, FlightMode.HOLD, STREAM_FIRST_S - 0.01) is Order.NOTHING
    assert asked(False, FlightMode.HOLD, STREAM_FIRST_S) is Order.OFFBOARD
    assert asked(False, FlightMode.OFFBOARD, STREAM_FIRST_S) is Order.ARM
    assert asked(True, FlightMode.OFFBOARD, STREAM_FIRST_S) is Order.NOTHING


def test_set_points_leave_only_with_a_permit_and_not_against_the_autopilots_landing() -> None:
    for permit, phase, armed, mode in EVERYTHING:
        if streams(permit, phase, armed, mode):
            assert permit is not Permit.NONE
            assert not (armed and mode in LANDS)
            assert armed or (permit, phase) == (Permit.POSITION, Phase.TAKEOFF)


@pytest.mark.parametrize("permit", [p for p in Permit if p not in (Permit.NONE, Permit.KILL)])
def test_in_the_air_every_permit_streams_while_the_autopilot_listens(permit: Permit) -> None:
    """Up to the moment in which it lands by itself: a gap before that would be a failsafe."""
    for phase, mode in product(Phase, (FlightMode.OFFBOARD, FlightMode.HOLD, FlightMode.OTHER)):
        assert streams(permit, phase, True, mode)


@pytest.mark.parametrize("mode", list(FlightMode))
def test_on_the_ground_a_take_off_begins_with_the_stream(mode: FlightMode) -> None:
    """Whatever the mode: after a landing the autopilot is still in it."""
    assert streams(Permit.POSITION, Phase.TAKEOFF, False, mode)


def test_motors_are_stopped_by_a_kill_alone_whatever_the_mode() -> None:
    for permit, phase, armed, mode in EVERYTHING:
        assert kills(permit, armed) == (permit is Permit.KILL and armed)
        if permit is Permit.KILL:
            assert not streams(permit, phase, armed, mode)
            assert next_order(permit, phase, armed, mode, 100.0) is Order.NOTHING


# orders.flown

GAPS_S = st.one_of(st.just(0.008), st.floats(0.0, 2.0))
TICKS = st.tuples(st.sampled_from(Permit), st.sampled_from(Phase), st.booleans(), st.sampled_from(FlightMode), GAPS_S)


@given(st.sampled_from([Flown.NOT_YET, Flown.LEFT]), st.lists(TICKS, max_size=30))
def test_an_autopilot_that_has_left_offboard_gets_no_set_point_before_a_new_take_off(first, ticks) -> None:
    """PX4 takes a stream up again by itself, after a failsafe and when it disarms. It leaves when none has come for long."""
    so_far, has_left, flew = first, first is Flown.LEFT, False
    for permit, phase, armed, mode, silent_s in ticks:
        so_far = flown(so_far, permit, phase, armed, mode, silent_s)
        anew = not armed and (permit, phase) == (Permit.POSITION, Phase.TAKEOFF)
        has_left = not anew and (has_left or (flew and (mode is not FlightMode.OFFBOARD or silent_s > AWAY_S)))
        flew = not anew and (flew or (armed and mode is FlightMode.OFFBOARD))
        assert (so_far is Flown.LEFT) == has_left
        assert not (has_left and streams(permit, phase, armed, mode, so_far))


def test_a_flight_from_take_off_to_landing_and_the_next_one() -> None:
    takeoff = (Permit.POSITION, Phase.TAKEOFF)
    so_far = flown(Flown.NOT_YET, *takeoff, False, FlightMode.HOLD, 0.008)
    so_far = flown(so_far, *takeoff, False, FlightMode.OFFBOARD, 0.008)
    assert so_far is Flown.NOT_YET
    so_far = flown(so_far, *takeoff, True, FlightMode.OFFBOARD, 0.008)
    assert so_far is Flown.OFFBOARD
    so_far = flown(so_far, Permit.LAND, Phase.LANDING, True, FlightMode.LAND, 0.008)
    assert so_far is Flown.LEFT
    assert flown(so_far, *takeoff, False, FlightMode.LAND, 0.008) is Flown.NOT_YET
