"""The supervisor by itself: what it answers, and what it says while the others speak, repeat themselves or are silent."""

import asyncio
from typing import Any

import numpy as np
import pytest

from schemas.message import TICK, Vec3
from schemas.safety import Action, OperatorRequest, Permit, Phase
from schemas.topics import (
    CABLE_FORCE,
    GUIDANCE,
    HANDLE_STATE,
    REPLY,
    REQUEST,
    ROBOT_POSE,
    SAFETY_STATE,
    SETPOINT,
    VEHICLE_STATE,
)
from schemas.tracking import RigidBody
from schemas.vehicle import FlightMode
from services.physics import Array
from services.safety_supervisor import service as safety_supervisor
from tests.services.alone import (
    Alone,
    Feed,
    Said,
    alone,
    force,
    frame,
    handle,
    pose,
    rate_Hz,
    setpoint,
    vehicle,
)
from tests.services.led import ABOVE, CONFIG, HAND, serving, tracked

ON_THE_GROUND = np.array([-2.0, -0.5, 0.08])


def noise(t_s: float) -> Array:
    """What is measured is never twice the same."""
    return 1e-6 * np.sin([700.0 * t_s, 900.0 * t_s, 1100.0 * t_s])


READY_FEEDS: dict[Any, Feed] = {
    HANDLE_STATE: lambda t: handle(HAND + noise(t)),
    ROBOT_POSE: lambda t: pose(ON_THE_GROUND + noise(t)),
    VEHICLE_STATE: lambda t: vehicle(ON_THE_GROUND + noise(t), armed=False, mode=FlightMode.HOLD),
    CABLE_FORCE: lambda t: force(noise(t)),
    GUIDANCE: lambda _: None,
}


def asked(feeds: dict[Any, Feed], *actions: Action) -> Said:
    """One action every 0.3 s, after half a second."""

    async def script(stage: Alone) -> None:
        await asyncio.sleep(0.5)
        for number, action in enumerate(actions, start=1):
            stage.say(REQUEST, OperatorRequest(action=action, operator="test", request_id=number))
            await asyncio.sleep(0.3)

    return alone(serving(safety_supervisor), feeds, script)


@pytest.mark.parametrize(
    ("missing", "why"),
    [
        (HANDLE_STATE, "the handle is not seen"),
        (ROBOT_POSE, "the vehicle is not seen"),
        (VEHICLE_STATE, "vehicle's state is stale"),
        (CABLE_FORCE, "force"),
    ],
    ids=["handle", "robot", "vehicle", "force"],
)
def test_a_start_is_refused_with_the_reason(missing, why):
    said = asked({topic: feed for topic, feed in READY_FEEDS.items() if topic is not missing}, Action.START)
    (reply,) = said[REPLY.key]
    assert not reply.accepted
    assert why in reply.text
    assert {m.phase for m in said[SAFETY_STATE.key]} == {Phase.IDLE}
    assert {m.permit for m in said[SAFETY_STATE.key]} == {Permit.NONE}
    assert any(why in reason for reason in said[SAFETY_STATE.key][-1].reasons)


@pytest.mark.parametrize("missing", ["robot", "handle"])
def test_what_the_tracker_knows_of_a_missing_body_is_what_the_operator_is_told(missing):
    """A marker body that does not exist comes with the frame; the supervisor says it in the place of its general cure."""
    trouble = f"no body {missing} in vrpn at mocap; it has: robbot, handel"
    seen = frame(ON_THE_GROUND, HAND).model_copy(update={"trouble": trouble, missing: RigidBody(tracked=False)})
    told = tracked(lambda _: seen, pull=None)[HANDLE_STATE.key][-1]
    assert (told.valid, told.invalid_reason) == (False, trouble)
    said = asked(READY_FEEDS | {HANDLE_STATE: lambda _: told}, Action.START)
    (reply,) = said[REPLY.key]
    assert reply.text == f"the handle is not seen: {trouble}"
    assert said[SAFETY_STATE.key][-1].reasons == [reply.text]


def test_in_flight_a_robot_that_is_hidden_does_not_take_the_handle_with_it():
    seen = frame(ABOVE, HAND).model_copy(update={"trouble": "no body robot", "robot": RigidBody(tracked=False)})
    assert tracked(lambda _: seen)[HANDLE_STATE.key][-1].valid


def test_a_world_whose_y_axis_is_up_is_what_the_operator_is_told():
    y_up = frame(np.array([-2.0, 0.08, 0.5]), np.array([-2.0, 0.02, 0.9]))
    told = tracked(lambda _: y_up, pull=None)[HANDLE_STATE.key][-1]
    said = asked({**READY_FEEDS, HANDLE_STATE: lambda _: told, ROBOT_POSE: lambda _: None}, Action.START)
    (reply,) = said[REPLY.key]
    assert reply.text.startswith(
        "the handle is not seen: the capture system's y axis is up: robot and handle lie still"
    )
    assert "let it stream with z up" in reply.text


def test_a_start_is_accepted_when_all_is_ready():
    said = asked(READY_FEEDS, Action.START)
    (reply,) = said[REPLY.key]
    assert (reply.accepted, reply.request_id) == (True, 1)
    states = said[SAFETY_STATE.key]
    assert list(dict.fromkeys(m.phase for m in states)) == [Phase.IDLE, Phase.TAKEOFF]
    started = states[-1]
    assert started.permit is Permit.POSITION
    assert started.goal_m.array()[:2] == pytest.approx(CONFIG.guided_path.p(0.0)[:2])
    assert rate_Hz(states) == pytest.approx(SAFETY_STATE.rate_Hz, rel=0.02)


def test_while_the_pilots_kill_switch_is_on_a_start_is_refused_and_nothing_is_over():
    on = vehicle(ON_THE_GROUND, armed=False, mode=FlightMode.HOLD).model_copy(update={"killed": True})
    moving = {VEHICLE_STATE: lambda t: on.model_copy(update={"position_m": Vec3.of(ON_THE_GROUND + noise(t))})}
    said = asked(READY_FEEDS | moving, Action.START)
    (reply,) = said[REPLY.key]
    assert (reply.accepted, reply.text) == (False, "the pilot's kill switch is on")
    assert {m.phase for m in said[SAFETY_STATE.key]} == {Phase.IDLE}
    assert said[SAFETY_STATE.key][-1].reasons[0].endswith("with nobody near: until then nothing arms")


def test_what_stays_exactly_the_same_is_silence():
    """New headers round an old measurement: a sensor, or what is behind it, has died."""
    said = asked(READY_FEEDS | {HANDLE_STATE: lambda _: handle(HAND)}, Action.START)
    (reply,) = said[REPLY.key]
    assert not reply.accepted
    assert "the handle is not seen" in reply.text


def test_a_verdict_names_what_it_was_made_of():
    said = asked(READY_FEEDS | {SETPOINT: lambda _: setpoint()}, Action.START)
    heard = {HANDLE_STATE, ROBOT_POSE, VEHICLE_STATE, CABLE_FORCE, SETPOINT, REQUEST}
    last = said[SAFETY_STATE.key][-1]
    assert set(last.inputs) == {topic.key for topic in heard} | {TICK}
    for topic in heard:
        seqs = {m.seq: m.stamp_ns for m in said[topic.key]}
        age_s = (last.stamp_ns - seqs[last.inputs[topic.key]]) * 1e-9
        assert age_s >= 0.0
        assert topic is REQUEST or age_s <= 1.0 / topic.rate_Hz + 1.0 / SAFETY_STATE.rate_Hz


def test_every_request_is_answered_under_its_number():
    said = asked(READY_FEEDS, Action.START, Action.HOLD, Action.RESUME, Action.LAND)
    assert [m.request_id for m in said[REPLY.key]] == [1, 2, 3, 4]
    phases = list(dict.fromkeys(m.phase for m in said[SAFETY_STATE.key]))
    assert phases[:3] == [Phase.IDLE, Phase.TAKEOFF, Phase.HOLD]
    assert phases[-1] is Phase.LANDED  # it never left the ground
