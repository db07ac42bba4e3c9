"""What the person feels when the system backs off: an ideal vehicle, a double integrator that holds to its set-point."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings

from schemas.safety import Permit
from services import cable
from services.faults.promises import CALM_N
from services.physics import Array, norm
from services.px4_bridge import flight
from services.px4_bridge.flight import Force, Input
from services.px4_bridge.leash import Hand
from tests.laws import ideal
from tests.laws.flown import HAND, LED, WANTED, ZERO, P, sight
from tests.laws.strategies import vectors


class Felt(NamedTuple):
    t_s: Array
    f_c: Array
    slack_m: Array


GAIN = 3.0  # rad/s of the vehicle's position loop, critically damped


def back_off(
    permit_at: Callable[[float], Input],
    v_person: Array,
    seconds: float,
    settle_s: float = 4.0,
    wrong_N: Array | None = None,
    sees: bool = False,
) -> Felt:
    """Led by the paper's pull until t = 0, then as told; from then on the person walks with `v_person` (ramped, 1 s).

    The estimate is right, but for `wrong_N` in the last sample before that; motion capture `sees` the hand or not.
    """
    dt, hand, state = 0.004, HAND, flight.initial(LED, P)
    p_R, v_R = LED, ZERO
    rows: list[tuple[float, Array, float]] = []
    for n in range(round(-settle_s / dt), round(seconds / dt)):
        v_H = v_person * min(max(n * dt, 0.0), 1.0)
        f_c = cable.force(p_R, hand, v_R, v_H, ideal.CABLE)
        slack_m = 1.0 - float(norm(p_R - hand))
        x = permit_at(n * dt)
        felt = wrong_N if wrong_N is not None and n == -1 else f_c
        forces = [Force(felt, slack_m > 0.02, dt)] if x.force_fresh else []
        seen = Hand(hand, v_H) if sees else None
        state, output = flight.step(state, x._replace(forces=forces, hand=seen), dt, P)
        pulled = GAIN**2 * (output.sent.p - p_R) + 2.0 * GAIN * (output.sent.v - v_R)
        v_R = v_R + dt * (output.sent.a + pulled - f_c / P.flight.m_R_kg)
        p_R, hand = p_R + dt * v_R, hand + dt * v_H
        rows.append((n * dt, f_c, slack_m))
    return Felt(*(np.array(column) for column in zip(*rows, strict=True)))


def eases(t_s: float) -> Input:
    return sight(Permit.GUIDE if t_s < 0.0 else Permit.EASE)


def test_led_it_pulls_as_the_paper_wants() -> None:
    """What the tests of backing off start from."""
    felt = back_off(lambda _: sight(Permit.GUIDE), ZERO, 0.0)
    assert felt.f_c[-1] == pytest.approx(WANTED, abs=0.02)


def test_ease_takes_the_pull_from_a_person_who_stands() -> None:
    """The cable hangs slack by about 5 cm along it; at no time is there more pull than before."""
    felt = back_off(eases, ZERO, 5.0)
    after_it = felt.t_s >= 0.0
    assert np.max(norm(felt.f_c[after_it])) < float(norm(WANTED)) + 0.1
    assert np.max(norm(felt.f_c[felt.t_s > 1.0])) == 0.0
    assert 0.02 < felt.slack_m[-1] < 0.06


@pytest.mark.parametrize("heading", [0.0, 2.0, np.pi])
def test_eased_a_person_who_walks_drags_it_along_at_b_A(heading: float) -> None:
    """Whichever way: horizontally b_A v and nothing else, once it moves with them."""
    speed = 0.4
    felt = back_off(eases, speed * np.array([np.cos(heading), np.sin(heading), 0.0]), 14.0)
    late = np.hypot(felt.f_c[:, 0], felt.f_c[:, 1])[felt.t_s > 9.0]
    assert np.max(late) < ideal.FILTER.b_A_Ns_per_m * speed + 0.05
    assert np.mean(late) == pytest.approx(ideal.FILTER.b_A_Ns_per_m * speed, abs=0.05)
    take_up_N = speed * np.sqrt(ideal.CABLE.k_c_N_per_m * P.flight.m_R_kg)  # a mass met at that speed (G7)
    assert np.max(norm(felt.f_c)) < float(norm(WANTED)) + take_up_N


def test_without_a_force_it_stops_and_hangs_slack() -> None:
    """Stale: no filter, no drift; the reference goes a little nearer to the hand and stays there."""

    def falls_silent(t_s: float) -> Input:
        return sight(Permit.GUIDE, fresh=t_s < 0.0)

    felt = back_off(falls_silent, ZERO, 5.0)
    assert np.max(norm(felt.f_c[felt.t_s > 3.0])) == 0.0
    assert felt.slack_m[-1] == pytest.approx(P.flight.ease_slack_m, abs=0.02)


def holds(t_s: float) -> Input:
    return sight(Permit.GUIDE if t_s < 0.0 else Permit.HOLD)


@pytest.mark.parametrize(("told", "sees"), [(eases, True), (eases, False), (holds, True), (holds, False)])
@given(wrong_N=vectors(4.0))
@settings(max_examples=20)
def test_where_it_backs_off_to_does_not_hang_on_one_sample(
    told: Callable[[float], Input], sees: bool, wrong_N: Array
) -> None:
    """The first step towards the hand goes by the newest force; where the hand is seen it decides, else the filter goes on."""
    felt = back_off(told, ZERO, 3.0, 1.5, wrong_N, sees)
    assert np.max(norm(felt.f_c[felt.t_s > 1.0])) < CALM_N
