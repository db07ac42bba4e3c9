"""The bridge's law: nothing jumps, whatever changes; backing off leaves no pull; orders and permits by their tables."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.safety import Permit
from schemas.vehicle import SetpointKind
from services.physics import Array, norm
from services.px4_bridge import admittance, flight
from services.px4_bridge.flight import Input
from tests.laws.flown import DT, LED, START, WANTED, ZERO, P, after, fly, guided, sight
from tests.laws.strategies import vectors

# Which way of flying follows from what is known.


@pytest.mark.parametrize(
    ("permit", "held", "fresh", "is_guided", "kind"),
    [
        (Permit.POSITION, False, True, True, SetpointKind.POSITION),
        (Permit.POSITION, False, False, False, SetpointKind.POSITION),
        (Permit.LAND, True, True, True, SetpointKind.POSITION),
        (Permit.WAIT, False, True, False, SetpointKind.ADMITTANCE),
        (Permit.WAIT, True, False, True, SetpointKind.EASE),
        (Permit.GUIDE, True, True, True, SetpointKind.ADMITTANCE),
        (Permit.GUIDE, True, True, False, SetpointKind.EASE),
        (Permit.GUIDE, True, False, True, SetpointKind.EASE),
        (Permit.GUIDE, False, True, False, SetpointKind.ADMITTANCE),
        (Permit.EASE, True, True, True, SetpointKind.EASE),
        (Permit.EASE, False, False, False, SetpointKind.EASE),
    ],
)
def test_the_way_of_flying(permit: Permit, held: bool, fresh: bool, is_guided: bool, kind: SetpointKind) -> None:
    _, output = flight.step(guided(), sight(permit, held=held, fresh=fresh, guided=is_guided), DT, P)
    assert output.kind is kind


# Bumpless.

SIGHTS = st.builds(
    sight,
    st.sampled_from([p for p in Permit if p is not Permit.NONE]),
    vectors(3.0),
    held=st.booleans(),
    fresh=st.sampled_from([True, True, True, False]),
    guided=st.sampled_from([True, True, True, False]),
)
HISTORIES = st.lists(st.tuples(SIGHTS, st.integers(1, 40)), min_size=3, max_size=8)


@settings(max_examples=40)
@given(vectors(1.0), HISTORIES)
def test_nothing_sent_jumps_whatever_changes(p_R: Array, history: list[tuple[Input, int]]) -> None:
    """Position within the step limit always, and by no more than the velocity's share while the filter is not cut short."""
    state = flight.initial(p_R, P)
    for x, ticks in history:
        for _ in range(ticks):
            before = state
            state, output = flight.step(state, x, DT, P)
            step_m = float(norm(output.sent.p - before.p_sent))
            assert step_m <= P.limits.step_max_m + 1e-12
            fastest = max(float(norm(before.filter.v)), float(norm(state.filter.v)))
            lag_m = float(norm(before.filter.p - before.p_sent))
            assert step_m <= 1.5 * DT * fastest + 0.5 * DT**2 * 20.0 + lag_m + 1e-12
            assert norm(output.sent.v) <= P.limits.v_max_mps + 1e-12
            assert np.hypot(output.sent.a[0], output.sent.a[1]) <= P.limits.a_xy_max_mps2 + 1e-12
            assert abs(output.sent.a[2]) <= P.limits.a_z_max_mps2 + 1e-12
            gained = state.feed_forward - before.feed_forward
            assert -DT / P.flight.feed_forward_drop_s - 1e-12 <= gained <= DT / P.flight.feed_forward_ramp_s + 1e-12


FLYING_PERMITS = [Permit.POSITION, Permit.WAIT, Permit.GUIDE, Permit.EASE, Permit.LAND]


@pytest.mark.parametrize(("one", "other"), [(a, b) for a, b in product(FLYING_PERMITS, repeat=2) if a is not b])
def test_a_change_begins_where_the_last_set_point_was(one: Permit, other: Permit) -> None:
    state = after(flight.initial(LED, P), sight(one, WANTED), 0.7)
    changed, output = flight.step(state, sight(other, WANTED), DT, P)
    speed = max(float(norm(state.filter.v)), float(norm(changed.filter.v)))
    assert norm(output.sent.p - state.p_sent) <= 1.5 * DT * speed + 1e-6
    assert changed.feed_forward == pytest.approx(state.feed_forward, abs=1.01 * DT / P.flight.feed_forward_drop_s)


def test_from_position_mode_the_filter_is_engaged_at_rest() -> None:
    """G9: at the last set-point sent, with v = 0."""
    moving = after(flight.initial(ZERO, P), sight(Permit.POSITION), 1.0)
    assert norm(moving.filter.v) > 0.3
    engaged, _ = flight.step(moving, sight(Permit.WAIT, np.array([0.0, 0.0, 0.3])), DT, P)
    assert norm(engaged.filter.p - moving.p_sent) < 1e-3
    assert norm(engaged.filter.v) < 0.05


def test_guiding_goes_on_from_ease_without_a_stop() -> None:
    """A person who walks on is not stopped by a change of permit."""
    led = after(guided(ZERO), sight(Permit.EASE, np.array([-1.2, 0.0, 0.3])), 2.0)
    assert norm(led.filter.v) > 0.4
    on, _ = flight.step(led, sight(Permit.GUIDE, np.array([-1.2, 0.0, 0.3])), DT, P)
    assert norm(on.filter.v - led.filter.v) < 0.1


@pytest.mark.parametrize(("permit", "to"), [(Permit.WAIT, 1.0), (Permit.EASE, 1.0), (Permit.POSITION, 0.0)])
def test_the_feed_forward_is_ramped_in_one_second(permit: Permit, to: float) -> None:
    state = flight.initial(LED, P) if to else guided()
    shares = [state.feed_forward, *(s.feed_forward for s, _ in fly(state, sight(permit, WANTED), 1.2))]
    assert shares[0] == 1.0 - to
    steps = np.abs(np.diff(shares))
    ramp = steps[: round(1.0 / DT) - 1]
    assert ramp == pytest.approx(np.full(len(ramp), DT))
    assert shares[-1] == to


@given(vectors(2.0), st.sampled_from([Permit.WAIT, Permit.EASE]))
@settings(max_examples=20)
def test_the_force_goes_into_the_acceleration_with_the_same_sample(f_c: Array, permit: Permit) -> None:
    """G2: a_sp = u_R + f_c/m_R once ramped in, u_R horizontally as it will be after the vehicle's lag."""
    state = after(flight.initial(START, P), sight(permit, ZERO), 1.2)
    state, output = flight.step(state, sight(permit, f_c), DT, P)
    fade = np.exp(-P.flight.lead_s * np.array(state.port.damping) / P.admittance.M_A_kg) * [1.0, 1.0, 0.0] + [
        0.0,
        0.0,
        1.0,
    ]
    assert output.sent.a == pytest.approx(fade * output.u_R + f_c / P.flight.m_R_kg, abs=1e-9)


@given(vectors(3.0))
@settings(max_examples=20)
def test_a_stale_force_moves_nothing(f_c: Array) -> None:
    """Whatever was felt last, no filter runs on it: the reference comes to rest within the slackening."""
    state = guided()._replace(f_hat=f_c, f_mean=f_c)
    stale = sight(Permit.GUIDE, fresh=False)
    rest = after(state, stale, 12.0)
    taut = norm(f_c) > 2.0 * P.flight.handle_weight_N + 0.1
    slackened = P.flight.ease_slack_m if taut else 0.0
    assert norm(rest.filter.p - state.filter.p) == pytest.approx(slackened, abs=2e-3)
    assert norm(rest.filter.v) < 1e-3
    assert rest.feed_forward == 0.0
    assert not np.any(rest.u_A)


@given(vectors(1.0), st.booleans())
@settings(max_examples=20)
def test_let_go_means_no_horizontal_force(f_c: Array, is_guided: bool) -> None:
    """G6: nobody holds the handle, so nothing pulls or anchors; the height is kept where it was let go."""
    state = guided()
    for _, output in fly(state, sight(Permit.GUIDE, f_c, held=False, guided=is_guided), 0.4):
        assert np.all(output.u_A[:2] == 0.0)
    weight = np.array([0.0, 0.0, P.flight.handle_weight_N])
    hung = after(state, sight(Permit.GUIDE, weight, held=False, guided=is_guided), 20.0)
    assert hung.filter.p[2] == pytest.approx(min(state.filter.p[2], P.flight.ceiling_m), abs=1e-3)
    assert norm(hung.filter.v) < 1e-3


def test_a_filter_that_makes_energy_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Five per cent more speed after each step than the law gives: the books do not close."""
    sound = admittance.step

    def faulty(*told: Any) -> tuple[admittance.State, Array]:
        state, u_A = sound(*told)
        return state._replace(v=1.05 * state.v), u_A

    pushed = sight(Permit.GUIDE, WANTED + [0.5, 0.0, 0.0])
    assert after(guided(), pushed, 1.0).port.balance.created_J < 1e-12
    monkeypatch.setattr(admittance, "step", faulty)
    assert after(guided(), pushed, 1.0).port.balance.created_J > 1e-3


def test_each_engagement_begins_with_a_full_tank_and_only_that() -> None:
    """Backing off and going on is the same walk: what was spent is spent."""
    state = guided()
    spent = state._replace(port=state.port._replace(tank=state.port.tank._replace(level_J=1.0)))
    eased = after(spent, sight(Permit.EASE, WANTED), 0.5)
    assert after(eased, sight(Permit.GUIDE, WANTED), 0.5).port.tank.level_J < 1.5
    stale = after(spent, sight(Permit.GUIDE, fresh=False), 0.5)
    assert after(stale, sight(Permit.GUIDE, WANTED), 0.5).port.tank.level_J < 1.5
    flown = after(eased, sight(Permit.POSITION), 0.5)
    assert after(flown, sight(Permit.WAIT), DT).port.tank.level_J == pytest.approx(P.tank.capacity_J, abs=1e-3)


def test_an_empty_tank_leaves_the_height_and_takes_the_pull() -> None:
    state = guided()
    empty = state._replace(port=state.port._replace(tank=state.port.tank._replace(level_J=0.0)))
    _, output = flight.step(empty, sight(Permit.GUIDE, WANTED), DT, P)
    assert np.all(np.abs(output.u_A[:2]) < 1e-3)  # what the damping of the first sample gave back
    assert output.u_A[2] == WANTED[2]


def test_waiting_it_is_anchored_over_the_start() -> None:
    pushed = after(
        flight.initial(START + [0.3, -0.2, 0.0], P), sight(Permit.WAIT, np.array([0.0, 0.0, 0.3]), held=False), 25.0
    )
    assert pushed.filter.p == pytest.approx(START, abs=0.01)


@given(vectors(3.0))
@settings(max_examples=20)
def test_the_filter_never_rises_above_the_ceiling(f_c: Array) -> None:
    for permit, held in product((Permit.WAIT, Permit.GUIDE, Permit.EASE), (True, False)):
        state = after(flight.initial(np.array([0.0, 0.0, 2.0]), P), sight(permit, f_c, held=held), 0.8)
        assert state.filter.p[2] <= P.flight.ceiling_m + 1e-9


def test_asked_to_land_it_stays_until_the_autopilot_takes_over() -> None:
    state = guided()
    assert norm(after(state, sight(Permit.LAND, WANTED), 5.0).filter.p - state.filter.p) < 0.01
