"""The robot without a bus: wired as the bridge wires it, and each vehicle of a batch with its own latency."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from schemas.safety import Permit
from services.config import load, load_vehicle
from services.force_estimator.observer import Observer
from services.px4_bridge import admittance
from services.px4_bridge import flight as bridge
from services.simulator import flight, tethered
from services.simulator.cascade import Setpoint
from services.simulator.flight import TICK_S, Latency
from tests.laws import ideal
from tests.laws.strategies import vectors

LIGHT = load_vehicle("light")
UP = np.array([0.0, 0.0, 1.0])


@settings(max_examples=10)
@given(vectors(0.5), vectors(0.5))
def test_set_points_are_the_bridges(wish: np.ndarray, pull: np.ndarray) -> None:
    """The set-points that its autopilot is told are those of the bridge's law in guidance on the same force samples."""
    config = load("demo").px4_bridge
    p = tethered.Robot(LIGHT, config.admittance, Observer(m_R_kg=0.8, bandwidth_Hz=8.0), lead_s=config.flight.lead_s)
    told = bridge.Params(config.flight, config.admittance, config.approach, config.limits, config.tank)
    start, f_d = 1.5 * UP, UP + wish
    state = tethered.hovering(start, UP, p)
    law = bridge.initial(start, told)._replace(kind=bridge.SetpointKind.ADMITTANCE, feed_forward=1.0)
    command = admittance.guide(start, f_d, 1.0, config.admittance)
    for _ in range(50):
        state = tethered.tick(state, -UP - pull, command, False, np.zeros(3), p)
        force = bridge.Force(state.f_c, False, TICK_S)
        x = bridge.Input(
            Permit.GUIDE, start, 0.5, True, [force], force_fresh=True, guidance=bridge.Guidance(start, f_d, 1.0)
        )
        law, out = bridge.step(law, x, TICK_S, told)
        used = state.flight.setpoints[-1]
        assert not out.sent.limited
        assert used.p_W == pytest.approx(out.sent.p, abs=1e-12)
        assert used.v_W == pytest.approx(out.sent.v, abs=1e-12)
        assert used.a_W == pytest.approx(out.sent.a, abs=1e-12)
        for _ in range(flight.SUBSTEPS):
            state = tethered.move(state, -UP - pull, p)


def test_each_vehicle_of_a_batch_has_its_own_latency() -> None:
    late = Latency(np.array([0, 2, 5]), np.array([3, 0, 1]))
    together = fly(np.tile(UP, (3, 1)), late)
    for i in range(3):
        alone = fly(UP, Latency(int(late.estimate[i]), int(late.setpoint[i])))
        assert together.robot.p_W[i] == pytest.approx(alone.robot.p_W, abs=1e-12)
    assert np.ptp(together.robot.p_W[:, 0]) > 1e-4  # and it matters


def fly(p_W: np.ndarray, latency: Latency) -> flight.State:
    """A set-point that jumps, and a push."""
    state = flight.hovering(p_W, LIGHT)
    for k in range(100):
        goal = p_W + (0.2 if k > 10 else 0.0) * np.array([1.0, 0.0, 0.0])
        yaw = np.zeros(p_W.shape[:-1])
        state = flight.steer(state, Setpoint(goal, 0.0 * goal, 0.0 * goal, yaw), LIGHT, latency)
        for _ in range(flight.SUBSTEPS):
            state = flight.move(state, 0.1 * UP + 0.0 * p_W, LIGHT)
    return state


def test_a_batch_flies_as_each_would_alone_and_its_input_is_left() -> None:
    masses = np.array([0.8, 1.2])
    both = tethered.Robot(LIGHT, admittance_of(masses), Observer(m_R_kg=0.8, bandwidth_Hz=8.0))
    wish = admittance.guide(np.tile(UP, (2, 1)), np.tile(UP + [1.0, 0.0, 0.0], (2, 1)), 1.0, both.filter)
    state = tethered.hovering(np.tile(UP, (2, 1)), UP, both)
    kept = state.flight.robot.p_W.copy()
    after = tethered.move(
        tethered.tick(state, -np.tile(UP, (2, 1)), wish, False, np.zeros((2, 3)), both), 0.0 * kept, both
    )
    assert np.array_equal(kept, state.flight.robot.p_W)
    for i, M_A in enumerate(masses):
        one = both._replace(filter=admittance_of(float(M_A)))
        alone = tethered.hovering(UP, UP, one)
        command = admittance.guide(UP, UP + [1.0, 0.0, 0.0], 1.0, one.filter)
        alone = tethered.move(tethered.tick(alone, -UP, command, False, np.zeros(3), one), np.zeros(3), one)
        assert after.reference.v[i] == pytest.approx(alone.reference.v, abs=1e-14)
        assert after.flight.robot.v_W[i] == pytest.approx(alone.flight.robot.v_W, abs=1e-12)


def admittance_of(M_A_kg: Any) -> admittance.Admittance:
    """A number, or a batch's array of them."""
    return dataclasses.replace(ideal.FILTER, M_A_kg=M_A_kg)


@pytest.mark.parametrize("name", ["light", "medium"])
def test_a_sudden_side_pull_is_given_way_to_as_the_filter_does(name: str) -> None:
    """1.5 N at once, in hover: without the lead in the set-point the light vehicle runs 12 cm ahead of its reference."""
    vehicle, config = load_vehicle(name), load("demo").px4_bridge
    given = dataclasses.replace(config.admittance, M_A_kg=vehicle.quadrotor.mass_kg)
    seen = Observer(m_R_kg=vehicle.quadrotor.mass_kg, bandwidth_Hz=8.0)
    peaks = [peak(tethered.Robot(vehicle, given, seen, lead_s=lead_s)) for lead_s in (0.0, config.flight.lead_s)]
    assert peaks[1] < 0.08
    assert peaks[1] < 0.5 * peaks[0]


def peak(p: tethered.Robot) -> float:
    """The largest distance of the vehicle from the reference, m."""
    state, side = tethered.hovering(1.5 * UP, np.zeros(3), p), np.array([0.0, 1.5, 0.0])
    command, away = admittance.ease(1.5 * UP, p.filter), 0.0
    for _ in range(round(2.0 / TICK_S)):
        state = tethered.tick(state, side, command, False, np.zeros(3), p)
        for _ in range(flight.SUBSTEPS):
            state = tethered.move(state, side, p)
        away = max(away, float(np.linalg.norm(state.flight.robot.p_W - state.reference.p)))
    return away
