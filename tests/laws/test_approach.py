"""Position mode: from anywhere and any velocity the reference comes to rest on the goal, within its limits."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.physics import Array, norm
from services.px4_bridge import approach
from services.px4_bridge.approach import Approach, State
from tests.laws.strategies import UNIT, vectors

P = Approach(a_max_mps2=0.8, rate_per_s=1.0)
DT = 0.008
SPEEDS = st.floats(0.1, 1.0)
PLACES, VELOCITIES = vectors(3.0), vectors(0.8)
ZERO = np.zeros(3)


class Flown(NamedTuple):
    p: Array
    v: Array
    a: Array


def fly(state: State, goal: Array, speed: float, seconds: float, dt: float = DT, p: Approach = P) -> Flown:
    rows: list[tuple[Array, Array, Array]] = []
    for _ in range(round(seconds / dt)):
        state, a = approach.step(state, goal, speed, dt, p)
        rows.append((state.p, state.v, a))
    return Flown(*(np.stack(column) for column in zip(*rows, strict=True)))


def batch(*vectors_: list[Array]) -> list[Array]:
    return [np.stack(v) for v in vectors_]


MANY = st.lists(st.tuples(PLACES, VELOCITIES, PLACES), min_size=20, max_size=20).map(
    lambda rows: batch(*map(list, zip(*rows, strict=True)))
)
few = settings(max_examples=12)  # each of twenty flights at once


@few
@given(MANY, SPEEDS)
def test_it_arrives_and_stays(many: list[Array], speed: float) -> None:
    """In the time that the way, the braking and the last slow centimetres take."""
    p, v, goal = many
    way = float(np.max(norm(goal - p))) + 1.0
    flown = fly(State(p, v), goal, speed, way / speed + 16.0, dt=0.04)
    assert np.max(norm(flown.p[-1] - goal)) < 1e-3
    assert np.max(norm(flown.v[-1])) < 1e-3


@few
@given(MANY, SPEEDS)
def test_it_is_never_faster_than_told_nor_than_it_came(many: list[Array], speed: float) -> None:
    p, v, goal = many
    flown = fly(State(p, v), goal, speed, 3.0)
    assert np.all(norm(flown.v) <= np.maximum(speed, norm(v)) + 1e-9)
    slowed = norm(v) / (2.0 * P.a_max_mps2) + 2 * DT  # by then any surplus is braked away
    assert np.all(norm(flown.v[round(float(np.max(slowed)) / DT) :]) <= speed + 1e-9)


@few
@given(MANY, SPEEDS, st.floats(0.001, 0.1))
def test_its_acceleration_is_bounded_and_its_motion_is_the_sum_of_it(
    many: list[Array], speed: float, dt: float
) -> None:
    p, v, goal = many
    flown = fly(State(p, v), goal, speed, 40 * dt, dt)
    assert np.all(norm(flown.a) <= 2.0 * P.a_max_mps2 + 1e-9)
    assert np.diff(flown.v, axis=0) == pytest.approx(flown.a[1:] * dt, abs=1e-12)
    assert np.diff(flown.p, axis=0) == pytest.approx(flown.v[1:] * dt, abs=1e-12)


@few
@given(UNIT, st.floats(0.01, 4.0), SPEEDS)
def test_from_rest_it_goes_straight_and_not_a_millimetre_too_far(way: Array, distance: float, speed: float) -> None:
    flown = fly(State(ZERO, ZERO), distance * way, speed, 6.0, dt=0.02)
    along = flown.p @ way
    assert np.max(along) <= distance + 1e-3
    assert np.all(np.diff(along) >= -1e-9)
    assert np.max(norm(flown.p - along[:, None] * way)) < 1e-9


@few
@given(MANY, SPEEDS)
def test_a_wrong_start_costs_no_more_than_its_braking_way(many: list[Array], speed: float) -> None:
    """Coming in too fast, sideways or backwards it strays by v²/2a, the larger acceleration being 2 a_max; not more."""
    p, v, goal = many
    flown = fly(State(p, v), goal, speed, 8.0, dt=0.02)
    strayed = np.max(norm(flown.p - goal), axis=0) - norm(p - goal)
    assert np.all(strayed <= norm(v) ** 2 / (4.0 * P.a_max_mps2) + 0.02 * norm(v) + 1e-3)


@few
@given(st.floats(0.3, 2.0), SPEEDS)
def test_it_brakes_as_gently_as_told(distance: float, speed: float) -> None:
    """Twice the braking is kept for corrections: on a straight way in, `a_max` is enough (and a tick's worth)."""
    flown = fly(State(ZERO, ZERO), np.array([distance, 0.0, 0.0]), speed, 8.0, dt=0.01)
    assert np.min(flown.a[:, 0]) >= -1.05 * P.a_max_mps2


def test_a_goal_that_moves_is_followed_without_a_jump() -> None:
    state, last = State(ZERO, ZERO), ZERO
    for n in range(1000):
        goal = np.array([1.0, 0.0, 1.0]) if (n // 150) % 2 else np.array([0.0, 1.0, 2.0])
        state, _ = approach.step(state, goal, 0.5, DT, P)
        assert norm(state.p - last) <= 0.5 * DT + 1e-12
        last = state.p


def test_at_the_goal_nothing_happens() -> None:
    flown = fly(State(ZERO, ZERO), ZERO, 0.5, 1.0)
    assert not np.any(flown.p)
    assert not np.any(flown.a)


def test_many_at_once_are_one_by_one() -> None:
    p, goal = np.linspace(-1.0, 1.0, 12).reshape(4, 3), np.linspace(2.0, -2.0, 12).reshape(4, 3)
    together = fly(State(p, 0.3 * goal), goal, 0.5, 1.0)
    for i in range(4):
        assert fly(State(p[i], 0.3 * goal[i]), goal[i], 0.5, 1.0).p == pytest.approx(together.p[:, i])
