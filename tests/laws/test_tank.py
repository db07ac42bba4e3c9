"""The filter behind its tank: passive at the cable whatever guidance does, unnoticed in a walk, and empty for a thief."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services import cable
from services.guiding_controller import maneuver
from services.physics import Array, norm
from services.px4_bridge import admittance, energy, tank
from services.px4_bridge.energy import Balance, Flow
from tests.laws import ideal
from tests.laws.strategies import DT, vectors

P, TANK = ideal.FILTER, ideal.TANK
Z_MAX = 0.8
ZERO = np.zeros(3)


class Told(NamedTuple):
    """One stretch of a history: what the filter is told, for how many steps of which length."""

    kind: int
    p_d: Array
    f_d: Array
    scale: float
    f_c: Array
    slack: bool
    dt: float
    steps: int

    def command(self) -> admittance.Command:
        return [
            admittance.guide(self.p_d, self.f_d, self.scale, P),
            admittance.wait(self.p_d, 0.4, P),
            admittance.hold_height(self.p_d, 0.4, P),
            admittance.ease(self.p_d, P),
            admittance.literal(self.f_d),
        ][self.kind]


TOLD = st.builds(
    Told,
    kind=st.integers(0, 4),
    p_d=vectors(2.0),
    f_d=vectors(3.0),
    scale=st.floats(0.0, 1.0),
    f_c=vectors(5.0),
    slack=st.booleans(),
    dt=DT,
    steps=st.integers(1, 8),
)
HISTORIES = st.lists(TOLD, min_size=1, max_size=8)
LEVELS = st.one_of(st.floats(0.0, TANK.capacity_J), st.floats(0.0, 0.02))


class Step(NamedTuple):
    told: Told
    before: admittance.State
    after: admittance.State
    tank_before: tank.State
    tank: tank.State
    u_A: Array
    through: Flow


def live(history: list[Told], v: Array, level_J: float) -> Iterator[Step]:
    """The filter behind its tank from the origin; commands change at will."""
    state, left = admittance.engage(ZERO)._replace(v=v), tank.State(level_J, 1.0)
    for told in history:
        for _ in range(told.steps):
            new, after, u_A, through = tank.step(
                left, state, told.f_c, told.command(), told.slack, told.dt, Z_MAX, P, TANK
            )
            yield Step(told, state, after, left, new, u_A, through)
            state, left = after, new


@given(HISTORIES, vectors(1.0), LEVELS)
@settings(max_examples=200)
def test_filter_and_tank_are_passive_at_the_cables_port(history: list[Told], v: Array, level_J: float) -> None:
    """Any commands, changed at any time, any dt, any cable force: ½ M v_xy² + T grows by the cable's work at most."""
    stored = supplied = 0.0
    for step in live(history, v, level_J):
        moved = step.after.p - step.before.p
        kinetic = 0.5 * P.M_A_kg * (step.after.v**2 - step.before.v**2)
        growth = float(kinetic[0] + kinetic[1] + step.tank.level_J - step.tank_before.level_J)
        work = -float(step.told.f_c[:2] @ moved[:2])
        assert growth <= work + 1e-9 * (1.0 + abs(work))
        assert float(kinetic[2]) <= step.through.height_J - float(step.told.f_c[2] * moved[2]) + 1e-9
        stored, supplied = stored + growth, supplied + work
    assert stored <= supplied + 1e-7


@given(HISTORIES, vectors(1.0), LEVELS)
@settings(max_examples=100)
def test_the_tank_is_never_overdrawn_nor_overfull(history: list[Told], v: Array, level_J: float) -> None:
    for step in live(history, v, level_J):
        assert 0.0 <= step.tank.level_J <= TANK.capacity_J
        assert 0.0 <= step.tank.scale <= 1.0
        assert step.through.guidance_J <= step.tank_before.level_J + 1e-12, "more was spent than there was"


@given(HISTORIES, vectors(1.0))
@settings(max_examples=100)
def test_no_step_creates_energy(history: list[Told], v: Array) -> None:
    """The balance at the filter's port closes to rounding for every dt; what is left over was lost, not made."""
    balance = energy.hand_over(Balance(), energy.kinetic(v, P.M_A_kg))
    for step in live(history, v, TANK.capacity_J):
        before = balance
        balance = energy.add(balance, step.through, energy.kinetic(step.after.v, P.M_A_kg))
        assert balance.created_J <= 1e-9
        assert balance.residual_J >= before.residual_J - 1e-9


@given(TOLD, vectors(1.0))
def test_empty_means_no_horizontal_force(told: Told, v: Array) -> None:
    """Neither pull nor spring; the height goes on as it was."""
    (first, *_) = live([told], v, 0.0)
    assert np.all(first.u_A[:2] == 0.0)
    full = next(live([told], v, TANK.capacity_J))
    assert first.u_A[2] == full.u_A[2]


@given(TOLD, vectors(1.0))
def test_full_it_changes_nothing(told: Told, v: Array) -> None:
    step = next(live([told], v, TANK.capacity_J))
    plain, u_A = admittance.step(step.before, told.f_c, told.command(), told.slack, told.dt, Z_MAX, P)
    assert all(np.array_equal(a, b) for a, b in zip((*step.after, step.u_A), (*plain, u_A), strict=True))


class Metered:
    """`admittance.step` behind a tank, for the ideal walk; keeps the levels and the books."""

    def __init__(self, capacity_J: float = TANK.capacity_J) -> None:
        self._tank = tank.Tank(capacity_J=capacity_J, fade_J=TANK.fade_J)
        self.left, self.balance = tank.charged(self._tank), Balance()
        self.levels, self.scales = list[float](), list[float]()

    def __call__(self, state: admittance.State, f_c: Array, *rest: Any) -> tuple[admittance.State, Array]:
        self.left, after, u_A, through = tank.step(self.left, state, f_c, *rest, tank=self._tank)
        self.balance = energy.add(self.balance, through, energy.kinetic(after.v, P.M_A_kg))
        self.levels.append(float(self.left.level_J))
        self.scales.append(float(self.left.scale))
        return after, u_A


def test_the_papers_walk_does_not_feel_the_tank() -> None:
    metered, path = Metered(), ideal.paper_path()
    plain = ideal.paper_walk()
    walk = ideal.walk(path, 38.0, step=metered)
    assert np.array_equal(walk.p_H, plain.p_H)
    assert min(metered.scales) == 1.0
    spent = TANK.capacity_J - min(metered.levels)
    print(f"spent {spent:.2f} J of {TANK.capacity_J} J; the path's work is {maneuver.work(path):.2f} J")
    assert spent < maneuver.work(path)
    assert min(metered.levels) > TANK.fade_J


def test_a_tank_that_is_too_small_lets_the_walk_fade_out() -> None:
    metered, path = Metered(capacity_J=2.0), ideal.paper_path()
    walk = ideal.walk(path, 40.0, step=metered)
    late = walk.t_s > 35.0
    assert norm(walk.p_H[-1] - path.p(1.0)) > 1.0, "it arrived all the same"
    assert np.max(norm(walk.f_c[late][:, :2])) < 0.1 * path.force.f_max_N
    assert np.max(np.abs(np.diff(walk.u_A[:, 0]))) < 0.05, "no step where it fades"


def test_the_residual_is_first_order_in_dt() -> None:
    """E = O(dt), one-sided: half the step, half of what is left over, and never any of it created."""
    left = list[float]()
    for dt in (0.01, 0.005, 0.0025):
        metered = Metered()
        ideal.walk(ideal.paper_path(), 10.0, dt=dt, step=metered)
        assert metered.balance.created_J < 1e-12
        left.append(float(metered.balance.residual_J))
    print(f"residual after 10 s: {', '.join(f'{1e3 * x:.2f} mJ' for x in left)} at 10, 5 and 2.5 ms")
    assert left[0] / left[1] == pytest.approx(2.0, abs=0.1)
    assert left[1] / left[2] == pytest.approx(2.0, abs=0.1)


def stolen(seconds: float, is_metered: bool, turn_per_s: float) -> tuple[float, float]:
    """Energy in J that a hand takes which is led wherever it happens to go, and how much of it in the last 10 s."""
    dt, hand = 0.008, ZERO
    state, left = admittance.engage(np.array([0.0, 0.0, 1.0])), tank.charged(TANK)
    taken, late = 0.0, 0.0
    for n in range(round(seconds / dt)):
        t = n * dt
        heading = np.array([np.cos(turn_per_s * t), np.sin(turn_per_s * t), 0.0])
        v_H = 0.5 * min(t, 1.0) * heading
        hand = hand + dt * v_H
        f_c = cable.force(state.p, hand, state.v, v_H, ideal.CABLE)
        jump = admittance.guide(state.p + 3.0 * heading, 1.5 * heading + [0.0, 0.0, 1.0], 1.0, P)  # always ahead of it
        if is_metered:
            left, after, _, _ = tank.step(left, state, f_c, jump, False, dt, 2.1, P, TANK)
        else:
            after, _ = admittance.step(state, f_c, jump, False, dt, 2.1, P)
        work, state = float(f_c[:2] @ (after.p - state.p)[:2]), after
        taken, late = taken + work, late + (work if t > seconds - 10.0 else 0.0)
    return taken, late


@pytest.mark.parametrize("turn_per_s", [0.0, 0.3])
def test_whoever_steals_energy_gets_what_is_in_the_tank_and_no_more(turn_per_s: float) -> None:
    """Guidance that jumps ahead of the hand for ever: a pump, unless it is metered."""
    taken, late = stolen(40.0, True, turn_per_s)
    assert taken < TANK.capacity_J
    pumped, still = stolen(40.0, False, turn_per_s)
    assert late < 0.02 * still
    assert pumped > 2.0 * TANK.capacity_J
    assert still > 3.0


def test_it_broadcasts() -> None:
    """A crowd of four, levels from empty to full, each as it would be alone."""
    p = np.linspace(-0.5, 0.5, 12).reshape(4, 3)
    levels = np.array([0.0, 1e-4, 0.3, 8.0])
    state = admittance.State(p, 0.4 * p[::-1], np.zeros((4, 3)), np.array([0.0, 0.5, 2.0, 9.0]))
    c, slack = admittance.guide(p[::-1], p + 1.0, np.full(4, 0.7), P), np.array([True, False, False, True])
    left, after, u_A, through = tank.step(tank.State(levels, np.ones(4)), state, p, c, slack, 0.01, 0.5, P, TANK)
    for i in range(4):
        one = admittance.State(*(v[i] for v in state))
        told = admittance.guide(p[3 - i], p[i] + 1.0, 0.7, P)
        single = tank.step(tank.State(float(levels[i]), 1.0), one, p[i], told, bool(slack[i]), 0.01, 0.5, P, TANK)
        assert [x[i] for x in left] == pytest.approx(list(single[0]))
        assert after.p[i] == pytest.approx(single[1].p)
        assert u_A[i] == pytest.approx(single[2])
        assert [x[i] for x in through[:5]] == pytest.approx(list(single[3][:5]))
