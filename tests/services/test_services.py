"""Each service by itself: what it makes of what the others say, and of their silence."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from schemas.estimation import Tare
from schemas.message import TICK
from schemas.safety import Permit, Phase
from schemas.topics import (
    CABLE_FORCE,
    GUIDANCE,
    HANDLE_STATE,
    MOCAP_FRAME,
    ROBOT_POSE,
    SAFETY_STATE,
    VEHICLE_IMU,
    VEHICLE_STATE,
)
from schemas.tracking import HandleSource
from services.force_estimator import service as force_estimator
from services.guiding_controller import service as guiding_controller
from services.physics import GRAVITY_MPS2, norm
from tests.services.alone import (
    Feed,
    Said,
    alone,
    frame,
    handle,
    inertial,
    lasting,
    pose,
    rate_Hz,
    since,
    vehicle,
    verdict,
)
from tests.services.led import ABOVE, CONFIG, HAND, SLACK, serving, tracked

# tracker


def test_the_tracker_answers_each_frame_with_its_hand_and_its_robot():
    velocity = np.array([0.5, -0.2, 0.0])
    said = tracked(lambda t_s: frame(ABOVE, HAND + velocity * t_s), pull=SLACK)
    frames = {m.seq: m for m in said[MOCAP_FRAME.key]}
    late = since(said, HANDLE_STATE, 0.6)
    assert len(late) == len(since(said, MOCAP_FRAME, 0.6))
    for m in late:
        origin = frames[m.inputs[MOCAP_FRAME.key]]
        assert m.valid
        assert (m.source, m.stamp_ns) == (HandleSource.MOCAP, origin.stamp_ns)
        assert m.position_m.array() == pytest.approx(origin.handle.position_m.array(), abs=0.002)
        assert m.velocity_mps.array() == pytest.approx(velocity, abs=0.01)
    for m in since(said, ROBOT_POSE, 0.6):
        assert m.stamp_ns == frames[m.inputs[MOCAP_FRAME.key]].stamp_ns
        assert m.position_m.array() == pytest.approx(ABOVE)
    assert len(since(said, ROBOT_POSE, 0.6)) == len(late)


def test_the_tracker_takes_no_jump_for_a_motion():
    """Swapped markers for two frames: the hand coasts, and no such pose reaches the autopilot."""
    jumped: set[int] = set()

    def frames(t_s: float):
        if 0.70 < t_s < 0.74:
            jumped.add(round(t_s * 1e3))
            return frame(ABOVE + [0.0, 0.5, 0.0], HAND + [0.5, 0.0, 0.0])
        return frame(ABOVE, HAND)

    said = tracked(frames)
    assert len(jumped) >= 2
    settled = since(said, HANDLE_STATE, 0.3)
    assert all(m.valid and m.source is HandleSource.MOCAP for m in settled)
    assert np.max([norm(m.position_m.array() - HAND) for m in settled]) < 0.005
    poses = since(said, ROBOT_POSE, 0.3)
    assert len(poses) == len(settled) - len(jumped)
    assert all(m.position_m.array() == pytest.approx(ABOVE) for m in poses)


def test_a_hidden_handle_is_found_at_the_end_of_the_taut_cable():
    said = tracked(lambda t_s: frame(ABOVE, HAND if t_s < 0.5 else None), 1.5)
    for m in since(said, HANDLE_STATE, 0.5 + CONFIG.tracker.handle.lost_s + 0.03):
        assert m.valid
        assert m.source is HandleSource.CABLE
        assert m.position_m.array() == pytest.approx(HAND, abs=1e-6)
        assert {MOCAP_FRAME.key, VEHICLE_STATE.key, CABLE_FORCE.key} == set(m.inputs)
    assert since(said, HANDLE_STATE, 1.2)
    assert len(since(said, ROBOT_POSE, 0.5)) == len(since(said, MOCAP_FRAME, 0.5))


def test_a_handle_that_is_seen_where_the_cable_does_not_lead_is_nowhere():
    """It is neither believed nor guessed: one of both is wrong."""
    said = tracked(lambda t_s: frame(ABOVE, HAND + (0.0 if t_s < 0.5 else 0.5)), 1.5)
    for m in since(said, HANDLE_STATE, 0.5 + CONFIG.tracker.handle.lost_s + 0.03):
        assert not m.valid
        assert m.source is HandleSource.NONE
        assert "where the cable does not lead" in m.invalid_reason
    assert since(said, HANDLE_STATE, 1.2)


def test_a_force_that_stays_exactly_the_same_contradicts_nobody():
    said = tracked(lambda t_s: frame(ABOVE, HAND + (0.0 if t_s < 0.5 else 0.5)), 1.5, frozen=True)
    assert {m.source for m in since(said, HANDLE_STATE, 1.2)} == {HandleSource.MOCAP}


@pytest.mark.parametrize(("pull", "why"), [(SLACK, "not taut"), (None, "no vehicle or force")], ids=["slack", "silent"])
def test_a_hidden_handle_without_a_pull_is_nowhere(pull, why):
    said = tracked(lambda t_s: frame(ABOVE, HAND if t_s < 0.3 else None), 1.0, pull=pull)
    lost = since(said, HANDLE_STATE, 0.3 + CONFIG.tracker.handle.lost_s + 0.03)
    assert lost
    for m in lost:
        assert not m.valid
        assert m.source is HandleSource.NONE
        assert why in m.invalid_reason


# force_estimator


def estimated(seconds: float, *, asked_at_s: float = 99.0, tare_s: float = 0.3) -> Said:
    """Hover with the handle hanging, biased by (0.2, 0.2, 0.4) N."""
    mass = CONFIG.vehicle.quadrotor.mass_kg
    weight = np.array([0.0, 0.0, CONFIG.force_estimator.bias.handle_weight_N])
    p = replace(CONFIG.force_estimator, bias=replace(CONFIG.force_estimator.bias, tare_s=tare_s))
    config = CONFIG.model_copy(update={"force_estimator": p})
    feeds: dict[Any, Feed] = {
        VEHICLE_IMU: lambda _: inertial(weight + [0.2, 0.2, 0.4], mass, mass * GRAVITY_MPS2),
        HANDLE_STATE: lambda _: handle(HAND),
        ROBOT_POSE: lambda _: pose(HAND + [0.0, 0.0, 1.0]),
        SAFETY_STATE: lambda t_s: verdict(Phase.ZEROING, Permit.POSITION, tare=t_s > asked_at_s),
    }
    return alone(lambda s: force_estimator.run(s.node("force_estimator"), config), feeds, lasting(seconds))


def test_each_inertial_sample_becomes_one_force_that_names_it():
    said = estimated(0.6)
    samples, forces = said[VEHICLE_IMU.key], said[CABLE_FORCE.key]
    assert len(samples) - len(forces) in (0, 1)  # the last may still be on its way
    for sample, m in zip(samples, forces, strict=False):
        assert m.inputs[VEHICLE_IMU.key] == sample.seq
        assert m.stamp_ns == sample.stamp_ns
    assert set(forces[-1].inputs) == {VEHICLE_IMU.key, HANDLE_STATE.key, ROBOT_POSE.key, SAFETY_STATE.key}
    assert forces[-1].slack_m == pytest.approx(0.0)
    assert forces[-1].tare is Tare.NONE


def test_the_estimator_zeroes_when_it_is_asked_to():
    said = estimated(1.2, asked_at_s=0.5)
    before, after = since(said, CABLE_FORCE, 0.45)[0], said[CABLE_FORCE.key][-1]
    weight_N = CONFIG.force_estimator.bias.handle_weight_N
    assert before.force_N.array() == pytest.approx([0.2, 0.2, 0.4 + weight_N], abs=0.01)
    assert list(dict.fromkeys(m.tare for m in said[CABLE_FORCE.key])) == [Tare.NONE, Tare.RUNNING, Tare.PASSED]
    assert after.force_N.array() == pytest.approx([0.0, 0.0, weight_N], abs=0.01)
    assert after.bias_N.array() == pytest.approx([0.2, 0.2, 0.4], abs=0.01)


# guiding_controller


def commanded(hand: Feed, safety: Feed, seconds: float = 1.0) -> list[Any]:
    feeds = {HANDLE_STATE: hand, VEHICLE_STATE: lambda _: vehicle(ABOVE), SAFETY_STATE: safety}
    return alone(serving(guiding_controller), feeds, lasting(seconds))[GUIDANCE.key]


def guide(t_s: float):
    return verdict(Phase.GUIDING, Permit.GUIDE, held=True)


def test_a_hand_that_walks_takes_the_guidance_along():
    path = CONFIG.guided_path
    commands = commanded(lambda t_s: handle(path.p(0.2 + 0.05 * t_s)), guide)
    led = [m for m in commands if m.valid]
    assert np.all(np.diff([m.s for m in led]) >= -1e-12)  # the projection's rounding
    assert led[-1].s == pytest.approx(0.2 + 0.05, abs=0.005)
    assert led[-1].scale == pytest.approx(1.0 / CONFIG.guiding_controller.ramp_s, abs=0.05)
    assert set(led[-1].inputs) == {HANDLE_STATE.key, VEHICLE_STATE.key, SAFETY_STATE.key, TICK}
    assert led[-1].f_d_N.array() == pytest.approx(1.5 * path.t_hat(led[-1].s) + [0, 0, 1.0], abs=0.01)
    assert rate_Hz(commands) == pytest.approx(GUIDANCE.rate_Hz, rel=0.02)


@pytest.mark.parametrize(
    "safety",
    [
        lambda t_s: verdict(Phase.GUIDING, Permit.GUIDE, held=t_s < 0.5),
        lambda t_s: verdict(Phase.GUIDING, Permit.GUIDE if t_s < 0.5 else Permit.EASE, held=True),
        lambda t_s: guide(t_s) if t_s < 0.5 else None,
    ],
    ids=["let go", "eased", "silent"],
)
def test_without_hand_permit_or_supervisor_nothing_pulls_and_s_stands_still(safety):
    """The silence counts once the last word is stale."""
    commands = commanded(lambda t_s: handle(CONFIG.guided_path.p(0.2 + 0.05 * t_s)), safety, 1.5)
    stale_s = 0.5 + SAFETY_STATE.timeout_s + 0.05
    pulled = [m.scale for m in commands if m.stamp_ns * 1e-9 - 1.0 < 0.5]
    after = [m for m in commands if m.stamp_ns * 1e-9 - 1.0 > stale_s]
    assert max(pulled) > 0.1
    assert {m.scale for m in after} == {0.0}
    assert {m.valid for m in after} == {True}


def test_a_stale_handle_means_no_guidance_and_says_why():
    commands = commanded(lambda t_s: handle(HAND) if t_s < 0.5 else None, guide)
    after = [m for m in commands if m.stamp_ns * 1e-9 - 1.0 > 0.5 + HANDLE_STATE.timeout_s + 0.03]
    assert after
    for m in after:
        assert not m.valid
        assert HANDLE_STATE.key in m.invalid_reason
        assert (m.scale, norm(m.f_d_N.array())) == (0.0, 0.0)
