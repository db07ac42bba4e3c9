"""What the bridge believes, and what a supervisor takes for silence."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.message import Vec3
from schemas.safety import Phase
from schemas.tracking import HandleSource, HandleState
from services.px4_bridge.flight import Guidance
from services.px4_bridge.orders import forgotten
from services.px4_bridge.trust import Trust, credible_force, credible_guidance
from services.safety_supervisor.novelty import Novelty
from tests.laws.strategies import vectors

P = Trust(force_max_N=30.0, push_max_N=1.5, f_d_max_N=2.0, pose_apart_m=0.3, lead_max_m=3.0)
LED = Guidance(np.array([0.8, 0.0, 1.6]), np.array([1.5, 0.0, 1.0]), 1.0)
HERE = np.array([0.0, 0.0, 1.6])


def test_what_the_method_asks_for_is_believed_and_the_same_in_milli_units_is_not():
    assert credible_guidance(LED, HERE, P)
    assert not credible_guidance(LED._replace(f_d=1000.0 * LED.f_d), HERE, P)
    assert not credible_guidance(LED._replace(p_R_d=1000.0 * LED.p_R_d), HERE, P)
    assert not credible_guidance(LED._replace(f_d=LED.f_d * [1.0, 1.0, -1.0]), HERE, P)
    assert not credible_guidance(LED._replace(scale=1.1), HERE, P)


@given(vectors(2.0))
def test_whatever_is_believed_of_guidance_is_bounded(f_d):
    if credible_guidance(LED._replace(f_d=f_d), HERE, P):
        assert np.linalg.norm(f_d) <= P.f_d_max_N
        assert f_d[2] >= 0.0


@given(vectors(20.0))
def test_a_cable_pulls_up_on_the_hand_and_no_harder_than_it_can(f_c):
    assert credible_force(f_c, P) == (np.linalg.norm(f_c) <= P.force_max_N and f_c[2] >= -P.push_max_N)


def handle(seq: int, x: float, t_s: float) -> HandleState:
    position = Vec3(x=x)
    return HandleState(
        seq=seq,
        stamp_ns=round(1e9 * t_s),
        position_m=position,
        velocity_mps=Vec3(),
        source=HandleSource.MOCAP,
        lag_s=0.0,
    )


@given(st.lists(st.sampled_from([0.0, 0.1, 0.2]), min_size=1, max_size=20))
def test_content_is_as_old_as_its_last_change(places):
    novelty, changed_s = Novelty(), 1.0
    for n, x in enumerate(places):
        t_s = 1.0 + 0.1 * n
        if n == 0 or x != places[n - 1]:
            changed_s = t_s
        assert novelty.age_s(handle(n + 1, x, t_s), 0.02) == pytest.approx(0.02 + t_s - changed_s, abs=1e-6)


def test_a_vehicle_is_forgotten_on_the_ground_only():
    for phase in Phase:
        assert not forgotten(phase, armed=True, in_air=True)
        assert not forgotten(phase, armed=False, in_air=False)
        assert forgotten(phase, armed=True, in_air=False) == (phase is not Phase.TAKEOFF)
