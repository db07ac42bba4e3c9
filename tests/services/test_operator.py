"""A person's commands: answered, obeyed, and what is said where nobody answers or nobody obeys."""

import asyncio

import pytest

from schemas.safety import Action, Level, OperatorReply, OperatorRequest, Permit, Phase
from schemas.topics import REPLY, SAFETY_STATE, SETPOINT
from schemas.vehicle import SetpointKind
from services.console.operator import Operator
from services.rehearsal.chain import Stage, until_guiding
from services.rehearsal.quick import quick_config
from services.safety_supervisor.requests import Requests
from tests.services.chain import fly


def give(*actions: Action, kill: tuple[str, ...] = ()):
    """The commands one after the other in guiding, with what was told and whether each was obeyed; then the flight."""
    told: list[str] = []
    obeyed: list[bool] = []

    async def script(stage: Stage) -> None:
        await until_guiding(stage, for_s=1.0)
        for name in kill:
            stage.kill(name)
        operator = Operator(stage.operator)
        for action in actions:
            obeyed.append(await operator.command(action, told.append))
            await asyncio.sleep(0.3)

    return told, obeyed, fly(quick_config(), script)


def test_stop_hold_and_resume_are_answered_and_obeyed():
    told, obeyed, flight = give(Action.EASE, Action.RESUME, Action.HOLD, Action.RESUME, Action.LAND)
    assert obeyed == [True] * 5, told
    assert "acknowledged" in told[0]
    assert "flies ease" in told[1]
    kinds = [m.kind for m in flight.said[SETPOINT.key]]
    assert SetpointKind.HOLD in kinds
    last = flight.said[SAFETY_STATE.key][-1]
    assert (last.phase, last.level) == (Phase.CLEARING, Level.LAND)
    assert last.reasons[0].startswith("a person asked to land")


@pytest.mark.parametrize("dead", [(), ("safety_supervisor",)], ids=["all well", "supervisor dead"])
def test_kill_stops_the_motors_whoever_lives(dead):
    told, obeyed, flight = give(Action.KILL, kill=dead)
    assert obeyed == [True], told
    assert "motors are off" in told[-1]
    assert not flight.vehicle.modes[-1][2]


def test_a_dead_bridge_cannot_kill_and_the_operator_is_told_what_can():
    told, obeyed, _ = give(Action.KILL, kill=("px4_bridge",))
    assert obeyed == [False]
    assert "NOT OBEYED" in told[-1]
    assert "kill switch" in told[-1]


def test_nobody_there_is_no_success():
    told, obeyed, _ = give(Action.EASE, kill=("safety_supervisor",))
    assert obeyed == [False]
    assert "no answer" in told[0]


def test_a_level_only_rises():
    """Asked for less than what is in force, the operator is told yes, and the graver stays."""
    _, obeyed, flight = give(Action.HOLD, Action.EASE)
    assert obeyed == [True, True]
    last = flight.said[SAFETY_STATE.key][-1]
    assert (last.level, last.permit) == (Level.HOLD, Permit.HOLD)


def test_a_repeated_request_is_answered_again_and_acted_upon_once():
    async def script(stage: Stage) -> None:
        await until_guiding(stage, for_s=0.5)
        stage.ask(Action.EASE, 2)
        await asyncio.sleep(0.2)
        stage.ask(Action.RESUME, 3)
        await asyncio.sleep(0.2)
        stage.ask(Action.EASE, 4)
        await asyncio.sleep(0.2)
        stage.ask(Action.RESUME, 3)  # a late copy
        await asyncio.sleep(0.2)

    flight = fly(quick_config(), script)
    assert flight.said[SAFETY_STATE.key][-1].level is Level.EASE
    assert [m.request_id for m in flight.said[REPLY.key]].count(3) == 2


def test_of_several_requests_the_gravest_comes_first_and_a_refusal_may_be_asked_again():
    requests = Requests()
    asked = [OperatorRequest(action=a, operator="", request_id=n) for n, a in enumerate(Action)]
    first = requests.next(asked)
    assert first is not None
    assert first.action is Action.KILL
    requests.answered(OperatorReply(request_id=first.request_id, accepted=True, text=""))
    second = requests.next(asked)
    assert second is not None
    assert second.action is Action.LAND
    assert [r.request_id for r in requests.replies()] == [first.request_id]
    requests.answered(OperatorReply(request_id=second.request_id, accepted=False, text="no"))
    assert requests.next([asked[second.request_id]]) == asked[second.request_id]
