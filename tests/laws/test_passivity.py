"""Thm 2 to 4 along runs: what is stored is at most what was there and what came in at both ports."""

import dataclasses
import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services import cable
from services.physics import GRAVITY_MPS2, Array, Components, norm
from services.px4_bridge import admittance
from services.simulator import human
from tests.laws import ideal
from tests.laws.closed_loop import Inputs, Loop, V, dissipated, equilibrium, runge_kutta
from tests.laws.test_human import P as PERSON


def batch(seed: int, n: int = 24) -> tuple[Loop, np.random.Generator]:
    """n loops over the ranges of test_theorems.LOOPS, and what else to draw from."""
    random = np.random.default_rng(seed)

    def drawn(low: float, high: float) -> Array:
        return np.exp(random.uniform(math.log(low), math.log(high), n))

    m_H = drawn(1.0, 20.0)
    f_z = np.minimum(drawn(0.1, 5.0), 0.9 * m_H * GRAVITY_MPS2)
    limits = ((1.0, 60.0), (0.3, 3.0), (0.5, 20.0), (0.3, 30.0))
    b_H, M_A, b_A, k_H = (drawn(*x) for x in limits)
    return Loop(m_H, b_H, M_A, b_A, k_H, f_z, drawn(10.0, 1000.0), drawn(0.2, 5.0)), random


def waves(random: np.random.Generator, n: int, size_N: float) -> Inputs:
    """Smooth, bounded u_A' and u_H: three sines for each axis."""
    size, phase = size_N * random.standard_normal((2, 3, 3, n)), random.uniform(0.0, math.tau, (2, 3, 3, n))
    rate = random.uniform(0.2, 4.0, size.shape)
    size[1, :, 2] = 0.0

    def at(t: float) -> tuple[Components, Components]:
        u_R, u_H = (size * np.sin(rate * t + phase)).sum(1)
        return list(u_R), list(u_H)

    return at


def steps(random: np.random.Generator, n: int, size_N: float, hold_s: float) -> Inputs:
    """Bounded u_A' and u_H that jump to new random values every `hold_s`."""
    drawn = random.uniform(-size_N, size_N, (200, 2, 3, n))
    drawn[:, 1, 2] = 0.0

    def at(t: float) -> tuple[Components, Components]:
        u_R, u_H = drawn[int(t / hold_s)]
        return list(u_R), list(u_H)

    return at


def anywhere(p: Loop, random: np.random.Generator) -> Array:
    """Slack for the most part, moving."""
    x, n = equilibrium(p), len(p.m_H)
    x[:, 0:2] += random.uniform(-1.0, 1.0, (n, 2))
    x[:, 3:5] = random.uniform(-1.0, 1.0, (n, 2))
    away = random.standard_normal((n, 3))
    length = (p.rest * random.uniform(0.0, 1.02, n))[:, None]
    x[:, 6:9] = x[:, 0:3] + length * away / norm(away)[:, None]
    x[:, 9:12] = random.uniform(-1.0, 1.0, (n, 3))
    return x


SEED = st.integers(0, 2**32 - 1)


@settings(max_examples=4)
@given(SEED)
def test_the_balance_of_taut_runs_closes_with_the_integrators_order(seed: int) -> None:
    """Thm 2 to 4 along runs: V - V(0) = supplied - dissipated, but for an error of order 4 in dt."""
    p, random = batch(seed)
    x, inputs = equilibrium(p), waves(random, 24, 0.05)
    errors: list[Array] = []
    taut = np.full(24, fill_value=True)
    for dt in (0.008, 0.004):
        xs, supplied, lost = runge_kutta(x, p, inputs, 3.0, dt)
        errors.append(np.max(np.abs(V(xs, p) - V(x, p) - supplied + lost), axis=0))
        taut &= np.all(norm(xs[..., 6:9] - xs[..., 0:3]) > p.rest, axis=0)
    seen = taut & (errors[1] > 1e-13)  # above rounding
    assert np.sum(seen) > 6
    order = np.log2(errors[0][seen] / errors[1][seen])
    assert np.median(order) == pytest.approx(4.0, abs=0.2)
    assert np.max(errors[1][taut]) < 1e-5


@settings(max_examples=4)
@given(SEED)
def test_stored_energy_is_at_most_initial_and_supplied(seed: int) -> None:
    """Thm 2 to 4 with inputs that jump, through slack and taut; the kink lowers the order of the error to 2."""
    p, random = batch(seed)
    x, inputs = anywhere(p, random), steps(random, 24, 3.0, hold_s=0.08)
    errors: list[Array] = []
    for dt in (0.008, 0.004, 0.002):
        xs, supplied, lost = runge_kutta(x, p, inputs, 3.0, dt)
        values = V(xs, p)
        error = np.max(np.abs(values - values[0] - supplied + lost), axis=0)
        unit = values[0] + np.max(np.abs(supplied), axis=0)
        assert np.max((values - values[0] - supplied) / unit) < 1e-6
        assert np.max(error / unit) < 200.0 * dt**2  # of 3000 such runs the worst has 47, at each dt
        errors.append(error)
    slack = np.any(norm(xs[..., 6:9] - xs[..., 0:3]) < p.rest, axis=0)
    assert np.sum(slack) > 12
    assert np.median(errors[0] / errors[2]) > 6.0


class Balance(NamedTuple):
    """Of one run in J: V less what Thm 2 to 4 say it is, what a held force explains of that, V less what they allow."""

    error: float
    held: float
    over: float


def fly(dt: float, seconds: float, height: float) -> Balance:
    """The laws that fly, on the paper's loop, from a robot at rest `height` above the hand.

    The robot is the admittance filter's reference (robotModel); both laws are exact for the cable's force held over dt.
    """
    p = Loop(5.0, 8.0, 0.8, 2.4, 4.5, 1.0, 200.0, 1.0)
    law = dataclasses.replace(ideal.FILTER, e_R_max_m=1e3)  # the theorems have no saturation
    now = equilibrium(p)
    now[8] = height
    robot, person = admittance.engage(now[6:9]), human.HumanState(now[0:3], now[3:6], np.array([1.0, 0.0, 0.0]))
    start, supplied, lost, held, over = float(V(now, p)), 0.0, 0.0, 0.0, -math.inf
    for n in range(round(seconds / dt)):
        t = (n + 0.5) * dt
        u_R = 0.2 * np.array([math.sin(2.0 * t), math.cos(1.3 * t), 0.5 * math.sin(3.0 * t)])
        u_H = np.array([2.0 * math.sin(1.1 * t), 1.5 * math.cos(0.7 * t), 0.0])
        f_c = cable.force(robot.p, person.p_H_W, robot.v, person.v_H_W, p.cable)
        command = admittance.guide(equilibrium(p)[6:9], np.array([0.0, 0.0, 1.0]) + u_R, 1.0, law)
        before = now
        robot, _ = admittance.step(robot, f_c, command, False, dt, 1e3, law)
        person = human.step(person, f_c, u_H, dt, PERSON)
        now = np.concatenate((person.p_H_W, person.v_H_W, robot.p, robot.v))
        moved = now - before
        supplied += float(u_R @ moved[6:9] + u_H @ moved[0:3])
        lost += 0.5 * dt * float(dissipated(before, p) + dissipated(now, p))
        later = cable.force(robot.p, person.p_H_W, robot.v, person.v_H_W, p.cable)
        held += 0.5 * float((later - f_c) @ (moved[6:9] - moved[0:3]))
        over = max(over, float(V(now, p)) - start - supplied)
    return Balance(float(V(now, p)) - start - supplied + lost, held, over)


def test_the_laws_that_fly_keep_the_balance_to_first_order() -> None:
    """A force held over dt is half a dt late, which feeds in ½ dt ḟ_c·l̇_c: as much as -k_c dt/2 of damping along the cable."""
    runs = [fly(dt, 4.0, 1.005) for dt in (0.004, 0.002, 0.001)]
    for coarse, fine in pairwise(runs):
        assert math.log2(coarse.error / fine.error) == pytest.approx(1.0, abs=0.1)
    for run in runs:
        assert run.error == pytest.approx(run.held, rel=0.02)
    for dt in (0.004, 0.001):
        slack = fly(dt, 4.0, 0.7)
        print(
            f"dt = {1e3 * dt:g} ms: balance off by {1e3 * slack.error:.2f} mJ of a held force, over {slack.over:.1e} J"
        )
        assert slack.over < 1e-6
