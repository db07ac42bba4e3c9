"""A walk over two hosts whose clocks are far apart, with an outage, and what its recordings are good for."""

import asyncio
import json

import pytest

from schemas.safety import Action, Phase
from schemas.topics import GUIDANCE, RADIO_CLOCK, SAFETY_STATE, TOPICS
from services.console import rerun as commands
from services.recorder.inspection import inspect
from services.recorder.reading import Session
from services.recorder.rerun import CannotRerun, rerun
from services.rehearsal.chain import Stage
from tests.services.two_hosts import LEAD_ns, Radio, fly, with_recorder_on

DRONES, GROUNDS = ("force_estimator", "safety_supervisor", "px4_bridge"), ("tracker", "guiding_controller")


async def walk_with_an_outage(stage: Stage, radio: Radio) -> None:
    await asyncio.sleep(2.0)
    stage.ask(Action.START)
    await stage.until(lambda state: state.phase is Phase.GUIDING, 60.0)
    await asyncio.sleep(1.5)
    radio.down = True
    await asyncio.sleep(1.2)
    radio.down = False
    await asyncio.sleep(2.0)


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("two_hosts")
    files = {host: folder / host / "session.mcap" for host in ("drone", "ground")}
    return fly(walk_with_an_outage, files), files


def said(session: Session, key: str):
    return [json.loads(payload) for payload in session.logs_of([key])[key].payloads]


def test_the_clocks_are_known_and_the_outage_eases_the_pull(flown):
    session = Session(flown[1]["drone"])
    clocks = said(session, RADIO_CLOCK.key)
    assert all(abs(c["ground_minus_drone_ns"] + LEAD_ns) <= 1e9 * c["uncertainty_s"] for c in clocks if c["valid"])
    assert len({c["ground_minus_drone_ns"] for c in clocks}) > 3  # it is not one number that all go by
    reasons = [" ".join(state["reasons"]) for state in said(session, SAFETY_STATE.key) if state["phase"] == "guiding"]
    assert any("the handle is not seen" in text for text in reasons)
    assert not reasons[-1]


@pytest.mark.parametrize("service", [*DRONES, *GROUNDS])
def test_what_was_recorded_on_its_host_comes_out_again_byte_for_byte(flown, service):
    config, files = flown
    host = config.host_of(service)
    outcome = rerun(Session(files[host]), service, with_recorder_on(host, config))
    assert outcome.first is None, outcome.notes
    assert outcome.notes == []
    assert outcome.equal


def test_the_comparison_that_dated_a_command_is_named(flown):
    session = Session(flown[1]["drone"])
    for state in said(session, SAFETY_STATE.key)[200:]:
        assert state["inputs"][RADIO_CLOCK.key] > 0
    for command in said(Session(flown[1]["ground"]), GUIDANCE.key)[200:]:
        assert command["inputs"][RADIO_CLOCK.key] > 0


def test_what_crossed_the_radio_thinned_is_not_run_again_and_told(flown, capsys):
    config, files = flown
    session = Session(files["ground"])
    for service in DRONES:
        with pytest.raises(CannotRerun, match=rf"{service}: .*thinned; a recorder on the drone has it whole"):
            rerun(session, service, with_recorder_on("ground", config))
    assert commands.command(files["ground"], [], [], None) == 0
    told = capsys.readouterr().out
    assert all(f"{service}: not run, " in told for service in DRONES)
    assert commands.command(files["ground"], ["px4_bridge"], [], None) == 2


def test_what_the_radio_thinned_is_not_missed(flown):
    lacking = inspect(Session(flown[1]["ground"])).lacking
    missed = [t.key for t in TOPICS if any(f"of {t.key} that are not there" in line for line in lacking)]
    assert missed == [RADIO_CLOCK.key], "what the outage took is"


def test_both_recordings_have_both_hosts_on_one_time(flown):
    """A message is in both at the same time of the file, to the radio's uncertainty, though the stamps are on two clocks."""
    drone, ground = (Session(flown[1][host]) for host in ("drone", "ground"))
    for session in (drone, ground):
        states, commands = (session.logs_of([key])[key] for key in (SAFETY_STATE.key, GUIDANCE.key))
        middle = len(commands.times_ns) // 2
        assert states.times_ns[0] < commands.times_ns[middle] < states.times_ns[-1]
