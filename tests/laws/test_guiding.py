"""Maneuver regulation: the force follows the hand, is bounded, and is never there without a hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.guiding_controller import guiding
from services.guiding_controller.path import project
from services.physics import Array, norm
from tests.laws import ideal

PATH = ideal.paper_path_cached()
POINT = st.tuples(st.floats(-3.0, 3.0), st.floats(-2.0, 2.0))
FLAG = st.booleans().map(np.array)


def at(s: float, scale: float) -> guiding.State:
    return guiding.State(np.array(s), np.array(scale))


def step(state: guiding.State, x: guiding.Input, dt: float = 0.01) -> tuple[guiding.State, guiding.Guidance]:
    return guiding.step(state, x, dt, PATH, ideal.GUIDING, ideal.CABLE)


def on(p_H: Array, held: guiding.Flags = ideal.YES, asked: guiding.Flags = ideal.YES) -> guiding.Input:
    return guiding.Input(p_H, p_H + np.array([0.0, 0.0, 1.0]), held, asked)


@given(POINT, st.floats(0.0, 1.0), st.floats(0.0, 1.0), FLAG, FLAG)
def test_without_a_hand_there_is_no_horizontal_force_and_s_rests(
    xy: tuple[float, float], s: float, scale: float, held: guiding.Flags, asked: guiding.Flags
) -> None:
    state, g = step(at(s, scale), on(np.array([*xy, 1.0]), held, asked))
    if not (held and asked):
        assert state.s == s
        assert g.scale == 0.0
        assert g.u_A == pytest.approx([0.0, 0.0, 1.0])


@given(POINT, POINT, st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.001, 0.1))
def test_every_command_is_bounded(
    hand: tuple[float, float], robot: tuple[float, float], s: float, scale: float, dt: float
) -> None:
    """G9: 1 N of spring and 1.5 N of pull; s* at 1 m/s at most, forwards or backwards."""
    x = guiding.Input(np.array([*hand, 1.0]), np.array([*robot, 1.6]), ideal.YES, ideal.YES)
    state, g = step(at(s, scale), x, dt)
    assert float(norm(g.u_A[:2])) <= float(g.scale) * (4.5 * 0.22 + 1.5) + 1e-9
    assert g.u_A[2] == 1.0
    assert abs(float(state.s) - s) * PATH.length_m <= 1.0 * dt + 1e-12
    assert 0.0 <= float(state.s) <= 1.0
    assert float(state.scale) <= scale + dt / 2.0 + 1e-12


@given(POINT, st.floats(0.0, 1.0))
def test_s_moves_towards_the_nearest_point_and_gets_there(xy: tuple[float, float], s: float) -> None:
    state, p_H = at(s, 1.0), np.array([*xy, 1.0])
    for _ in range(3):
        before = abs(float(project(p_H, PATH, state.s, 0.5)) - float(state.s))
        moved, g = step(state, on(p_H))
        assert abs(float(moved.s) - float(state.s)) <= before + 1e-12
        assert (float(moved.s) - float(state.s)) * (float(g.s_nearest) - float(state.s)) >= 0.0
        state = moved


def test_a_standing_person_is_waited_for() -> None:
    """Maneuver regulation, not trajectory tracking: s* and with it the error do not grow."""
    p_H = PATH.p(0.3) + 0.1 * PATH.normal(0.3)
    state = at(0.3, 1.0)
    for _ in range(300):
        state, _ = step(state, on(p_H))
    _, g = step(state, on(p_H))
    assert float(state.s) == pytest.approx(0.3, abs=1e-6)
    assert float(g.e_H_m) == pytest.approx(0.1, abs=1e-6)


def test_the_ramp_takes_two_seconds_and_falls_at_once() -> None:
    state = guiding.start(PATH.p(0.2), PATH)
    x = on(PATH.p(0.2))
    scales = []
    for _ in range(250):
        state, g = step(state, x)
        scales.append(float(g.scale))
    assert scales == pytest.approx(np.minimum(np.arange(1, 251) / 200.0, 1.0).tolist())
    assert float(step(state, x._replace(held=ideal.NO))[1].scale) == 0.0


def test_the_guidance_for_the_bridge_is_not_scaled() -> None:
    p_H = PATH.p(0.5)
    _, g = step(at(0.5, 0.3), on(p_H))
    _, full = step(at(0.5, 1.0), on(p_H))
    assert g.f_d == pytest.approx(full.f_d)
    assert g.p_R_d == pytest.approx(full.p_R_d)
    assert float(norm(full.f_d[:2])) == pytest.approx(1.5)


def test_at_the_end_it_is_regulation_to_the_goal() -> None:
    """s* = 1: Thm 1 holds, no horizontal force where the robot stands above the hand."""
    p_H = PATH.p(1.0)
    _, g = step(at(1.0, 1.0), guiding.Input(p_H, p_H + np.array([0.0, 0.0, 1.005]), ideal.YES, ideal.YES))
    assert g.u_A == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)


def test_it_broadcasts_over_people() -> None:
    s = np.linspace(0.1, 0.9, 6)
    p_H = PATH.p(s) + 0.05 * PATH.normal(s)
    held = np.array([True, False] * 3)
    state = guiding.State(s + 0.001, np.full(6, 0.5))
    x = guiding.Input(p_H, p_H + np.array([0.3, 0.0, 0.9]), held, np.full(6, True))
    _, together = step(state, x)
    for i in range(6):
        _, one = step(guiding.State(state.s[i], state.scale[i]), guiding.Input(*(v[i] for v in x)))
        for name in guiding.Guidance._fields:
            assert getattr(together, name)[i] == pytest.approx(getattr(one, name), abs=1e-12)
