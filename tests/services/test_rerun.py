"""Recorded inputs through the present code: the same bytes, or the first message that differs and both its values."""

import asyncio
from copy import copy

import pytest

from schemas.message import TICK
from schemas.safety import Action
from schemas.topics import CABLE_FORCE, GUIDANCE, HANDLE_STATE, SAFETY_STATE, SETPOINT
from services.console import rerun as commands
from services.console.rerun import config_with
from services.guiding_controller import service as guiding_controller
from services.recorder.difference import ABSENT, difference
from services.recorder.reading import Log, read
from services.recorder.rerun import CannotRerun, rerun
from services.recorder.rerun_subjects import SUBJECTS
from services.rehearsal.chain import Stage
from services.rehearsal.quick import quick_config
from services.runtime.node import Node
from tests.services.chain import fly


def changed(session, change):
    """The session with other logs: `change` takes and gives back a dict of them."""
    other = copy(session)
    logs = change(session.logs_of(session.keys))
    other.logs_of = lambda keys: {key: logs[key] for key in keys if key in logs}
    return other


def without(session, key: str, *rows: int):
    """The session less some messages of a topic."""

    def change(logs):
        kept = [i for i in range(len(logs[key].payloads)) if i not in rows]
        fewer = Log([logs[key].payloads[i] for i in kept], [logs[key].times_ns[i] for i in kept])
        return logs | {key: fewer}

    return changed(session, change)


@pytest.fixture(scope="module")
def config(recorded, flown):
    return config_with(recorded, flown[1], [])


@pytest.mark.parametrize("service", SUBJECTS)
def test_a_whole_flight_comes_out_again_byte_for_byte(recorded, config, service):
    outcome = rerun(recorded, service, config)
    assert outcome.first is None
    assert outcome.notes == []
    assert outcome.equal
    topics = (SUBJECTS[service].turns, *SUBJECTS[service].also)
    assert outcome.compared == sum(len(recorded.logs[topic.key].payloads) for topic in topics)


def test_another_parameter_names_the_first_message_that_differs_and_both_values(recorded, flown):
    config = config_with(recorded, flown[1], ["px4_bridge.admittance.k_H_N_per_m=5.5"])
    outcome = rerun(recorded, "px4_bridge", config)
    first = outcome.first
    assert first is not None
    assert not outcome.equal
    assert first.topic == SETPOINT.key
    assert first.field.split(".")[0] in ("position_m", "velocity_mps", "u_A_N")
    assert first.recorded == pytest.approx(first.said, abs=1e-3)
    assert first.recorded != first.said
    pairs = zip(recorded.logs[SETPOINT.key].payloads, outcome.said[SETPOINT.key], strict=True)
    seq = next(n for n, (one, other) in enumerate(pairs, 1) if one != other)
    assert first.seq == seq
    assert str(first.recorded) in str(first)


def test_an_input_that_was_not_recorded_is_named(recorded, config):
    outcome = rerun(without(recorded, HANDLE_STATE.key, 2000), "guiding_controller", config)
    assert any("used handle/state 2001, which was not recorded" in note for note in outcome.notes)


def test_a_lost_output_is_no_difference(recorded, config):
    outcome = rerun(without(recorded, CABLE_FORCE.key, 100, 101), "guiding_controller", config)
    assert outcome.equal
    outcome = rerun(without(recorded, GUIDANCE.key, 10), "guiding_controller", config)
    assert outcome.compared == len(recorded.logs[GUIDANCE.key].payloads) - 1


def test_a_service_that_was_started_again_starts_again(tmp_path):
    """And a bridge that stopped sending after a landing forgets all that it felt before it sends again."""

    async def script(stage: Stage) -> None:
        await asyncio.sleep(0.5)
        stage.ask(Action.START)
        await asyncio.sleep(1.5)
        stage.tasks.pop("guiding_controller").cancel()
        await asyncio.sleep(0.3)
        node = Node("guiding_controller", stage.bus, stage.operator.clock)
        stage.tasks["guiding_controller"] = asyncio.create_task(guiding_controller.run(node, config))
        await asyncio.sleep(1.0)

    config = quick_config()
    fly(config, script, record=tmp_path / "session.mcap")
    session = read(tmp_path / "session.mcap")
    assert session.verdict.topics[GUIDANCE.key].restarts == 1
    for service in SUBJECTS:
        assert rerun(session, service, config).equal, service


def test_a_recording_without_the_turns_clock_is_refused(recorded, config):
    log = recorded.logs[SAFETY_STATE.key]
    old = Log([payload.replace(b'"said_ns"', b'"other"') for payload in log.payloads[:50]], log.times_ns[:50])
    with pytest.raises(CannotRerun, match="older than reruns"):
        rerun(changed(recorded, lambda _: {SAFETY_STATE.key: old}), "safety_supervisor", config)
    with pytest.raises(CannotRerun, match="nothing of setpoint/sent"):
        rerun(changed(recorded, lambda _: {}), "px4_bridge", config)


def test_every_tick_is_in_the_recording(recorded):
    ticks = recorded.table(SAFETY_STATE)[f"inputs.{TICK}"]
    assert ticks.tolist() == list(range(1, len(ticks) + 1))


def test_where_two_messages_part():
    one = b'{"seq":3,"a":{"x":1.0,"y":2.0},"b":[1,2],"c":true}'
    assert difference("t", one, one.replace(b"2.0", b"2.5"), 0.0)[3:] == ("a.y", 2.0, 2.5)
    assert difference("t", one, one.replace(b"[1,2]", b"[1]"), 0.0)[3:] == ("b", [1, 2], [1])
    assert difference("t", one, one.replace(b"true", b"1"), 0.0)[3:] == ("c", True, 1)
    assert difference("t", one, one.replace(b',"c":true', b""), 0.0)[3:] == ("c", True, ABSENT)
    assert difference("t", None, one, 0.0)[:2] == ("t", 3)
    assert "other words" in str(difference("t", one, one.replace(b":1.0", b": 1.0"), 0.0))


def test_the_command_says_by_its_exit_code_what_came_out(flown, tmp_path, capsys):
    _, file = flown
    assert commands.command(file, ["tracker"], [], None) == 0
    figure = tmp_path / "curves.png"
    assert commands.command(file.parent, ["guiding_controller"], ["guiding_controller.f_z_N=1.2"], figure) == 0
    assert figure.stat().st_size > 10_000
    for settings, complaint in (
        (["guiding_controller.f_z=1.2"], "no such parameter"),
        (["guiding_controller.f_z_N=-1.2"], "guiding_controller.f_z_N = -1.2: must be greater than 0"),
        (["guiding_controller.f_z_N"], "must be key=value"),
    ):
        assert commands.command(file, [], settings, None) == 2
        assert complaint in capsys.readouterr().err
    assert commands.command(file, ["recorder"], [], None) == 2
    assert "must be one of tracker" in capsys.readouterr().err
    assert commands.command(tmp_path / "none", [], [], None) == 2
