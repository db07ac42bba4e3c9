"""The free handle: a pendulum, a stone on the floor, and stable on a stiff cable."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services import cable
from services.cable import Cable
from services.physics import GRAVITY_MPS2, norm
from services.simulator import handle
from services.simulator.handle import Handle, HandleState

DT = 0.001
ROBOT = np.array([0.0, 0.0, 2.0])
STILL = np.zeros(3)


def handle_of(mass_kg: float = 0.04, drag: float = 0.0, friction: float = 0.5) -> Handle:
    return Handle(mass_kg=mass_kg, drag_Ns_per_m=drag, height_m=0.02, friction=friction)


def cable_of(k_c: float = 200.0, d_c: float = 1.0) -> Cable:
    return Cable(rest_length_m=1.0, k_c_N_per_m=k_c, d_c_Ns_per_m=d_c)


def hang(state: HandleState, seconds: float, p: Handle, c: Cable, robot=ROBOT) -> list[HandleState]:
    states = [state]
    for _ in range(round(seconds / DT)):
        f_c = cable.force(robot, states[-1].p_W, STILL, states[-1].v_W, c)
        states.append(handle.step(states[-1], f_c, DT, p))
    return states


def energy(s: HandleState, p: Handle, c: Cable) -> float:
    spring = cable.energy(norm(ROBOT - s.p_W), c)
    return float(spring + p.mass_kg * (0.5 * s.v_W @ s.v_W + GRAVITY_MPS2 * s.p_W[2]))


def test_it_comes_to_hang_below_the_robot_with_its_weight_on_the_cable():
    p, c = handle_of(drag=0.05), cable_of()
    end = hang(HandleState(np.array([0.3, 0.0, 1.1]), STILL), 20.0, p, c)[-1]
    weight = p.mass_kg * GRAVITY_MPS2
    assert end.p_W == pytest.approx([0.0, 0.0, 1.0 - weight / c.k_c_N_per_m], abs=1e-3)
    assert cable.force(ROBOT, end.p_W, STILL, end.v_W, c)[2] == pytest.approx(weight, rel=0.01)


def test_it_swings_with_the_period_of_a_pendulum():
    small = 0.05
    states = hang(HandleState(ROBOT + [math.sin(small), 0.0, -math.cos(small)], STILL), 5.0, handle_of(), cable_of())
    x = np.array([s.p_W[0] for s in states])
    crossings = np.flatnonzero(np.diff(np.sign(x)))
    assert 2 * DT * np.diff(crossings).mean() == pytest.approx(math.tau * math.sqrt(1 / GRAVITY_MPS2), rel=0.01)


@pytest.mark.parametrize("k_c", [50.0, 200.0, 500.0])
@pytest.mark.parametrize("mass_kg", [0.005, 0.04])
def test_on_a_stiff_lossless_cable_the_energy_stays_bounded(k_c, mass_kg):
    p, c = handle_of(mass_kg), cable_of(k_c, d_c=0.0)
    start = HandleState(ROBOT + [0.5, 0.0, -0.9], STILL)
    energies = np.array([energy(s, p, c) for s in hang(start, 5.0, p, c)])
    scale = p.mass_kg * GRAVITY_MPS2 * 1.0
    ripple = DT * math.sqrt(k_c / mass_kg)  # of a symplectic step, relative to the energy of the spring's oscillation
    assert np.ptp(energies) < (ripple + 0.05) * (scale + cable.energy(norm(ROBOT - start.p_W), c))
    assert energies[-1000:].mean() < energies[:1000].mean() + 0.05 * scale


@pytest.mark.parametrize("k_c", [200.0, 500.0])
@pytest.mark.parametrize("mass_kg", [0.005, 0.01, 0.05])
def test_a_damped_cable_brings_a_dropped_handle_to_rest(k_c, mass_kg):
    p, c = handle_of(mass_kg, drag=0.02), cable_of(k_c)
    end = hang(HandleState(ROBOT + [0.0, 0.0, -0.2], STILL), 10.0, p, c)[-1]
    assert norm(end.v_W) < 1e-3


def test_it_lies_on_the_floor_and_is_lifted_by_the_rising_robot():
    p, c = handle_of(), cable_of()
    lying = HandleState(np.array([0.4, 0.0, p.height_m]), STILL)
    assert hang(lying, 1.0, p, c, robot=np.array([0.0, 0.0, 0.1]))[-1].p_W == pytest.approx(lying.p_W)
    assert hang(lying, 2.0, p, c)[-1].p_W[2] > 0.5


def test_friction_stops_a_slide_after_the_distance_of_coulomb():
    p = handle_of(friction=0.5)
    end = HandleState(np.array([0.0, 0.0, p.height_m]), np.array([0.6, 0.8, 0.0]))
    for _ in range(1000):
        end = handle.step(end, STILL, DT, p)
    distance = 1.0 / (2 * p.friction * GRAVITY_MPS2)
    assert end.p_W[:2] == pytest.approx(np.array([0.6, 0.8]) * distance, abs=2e-3)
    assert end.v_W == pytest.approx(STILL)


@settings(deadline=None, max_examples=50)
@given(
    st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.02, 2)).map(np.array),
    st.tuples(*[st.floats(-5, 5)] * 3).map(np.array),
)
def test_it_never_falls_through_the_floor_and_batches(p_W, v_W):
    p = handle_of()
    one, both = HandleState(p_W, v_W), HandleState(np.stack((p_W, p_W)), np.stack((v_W, v_W)))
    for _ in range(300):
        one, both = handle.step(one, STILL, DT, p), handle.step(both, np.zeros((2, 3)), DT, p)
        assert one.p_W[2] >= p.height_m - 1e-12
    assert both.p_W[1] == pytest.approx(one.p_W)
