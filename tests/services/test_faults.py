"""The whole campaign of faults, a test for each; and flights without any."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from schemas.safety import Level
from services.faults import report
from services.faults.campaign import alone, campaign, processors, unremarked
from services.faults.catalogue import every, named
from services.faults.measure import Result, measure
from services.faults.nominal import flight, flights
from services.faults.rows.vehicles import heeds_a_pilot

pytestmark = pytest.mark.timeout(1800)  # whoever asks first waits for all
FAULTS = {fault.name: fault for fault in every()}


@pytest.fixture(scope="module")
def results() -> dict[str, Result]:
    return {result.name: result for result in campaign(every(), processors())}


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_what_must_hold_holds(results, name):
    assert results[name].ok, (results[name].broken, results[name].reasons)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["force_thousandfold", "lifts_the_hand"])
def test_what_is_flown_in_a_copy_is_what_is_flown_alone(results, name):
    """In every number: a fault of the bus, and a person's deed."""
    with unremarked():
        assert measure(FAULTS[name], *alone(FAULTS[name])) == results[name]


def test_the_campaign_finds_a_promise_that_is_not_kept():
    """An impossible promise is a broken one: the verdicts are not always yes."""
    fault = named("clew_stop")
    assert fault is not None
    (result,) = campaign([replace(fault, within_s=1e-4)])
    assert not result.ok
    assert "promised 0.0001 s" in result.broken[0]


def test_an_autopilot_that_does_not_refuse_is_armed():
    """So the rows in which nothing happens say something."""
    fault = named("arming_denied")
    assert fault is not None
    (result,) = campaign([replace(fault, act=lambda stage: None)])
    assert result.broken == ("armed",)


@pytest.mark.slow
def test_after_a_pilots_kill_the_supervisor_says_so(results):
    killed = results["pilot_kills"]
    assert (killed.phase, killed.level) == ("killed", "kill")
    assert killed.reasons[-1].startswith("the pilot's kill switch is on")
    assert killed.impact_mps > 0.0


def test_with_the_parameter_of_the_simulation_a_pilots_kill_switch_does_nothing():
    """So the hardware's profile has another."""
    deaf = replace(FAULTS["pilot_kills"], world=lambda config: heeds_a_pilot(config, COM_RC_IN_MODE=4))
    (result,) = campaign([deaf])
    assert result.broken == ("motors off after inf s, promised 0.2 s",)


def test_a_fault_that_cannot_be_flown_is_no_success():
    fault = named("clew_stop")
    assert fault is not None

    def fails(stage):
        raise ValueError("no such knob")

    (result,) = campaign([replace(fault, act=fails)])
    assert result.broken == ("ValueError: no such knob",)


def test_a_deed_that_should_have_begun_before_its_moment_is_no_success():
    fault = named("lets_go")
    assert fault is not None
    (result,) = campaign([replace(fault, deeds=(replace(fault.deeds[0], start_s=1.0),))])
    assert result.broken[0].startswith("ValueError"), result.broken
    assert "should have begun" in result.broken[0]


def test_every_fault_has_a_name_of_its_own_and_says_what_breaks():
    names = [fault.name for fault in every()]
    assert len(set(names)) == len(names) > 120
    assert all(re.fullmatch(r"[a-z0-9_]+", name) for name in names)
    assert all(len(fault.about.split()) >= 3 for fault in every())


def test_the_table_of_the_documentation_is_of_this_catalogue():
    text = (Path(__file__).parents[2] / "docs/safety.md").read_text()
    block = text.split(report.TABLE[0])[1].split(report.TABLE[1])[0].strip().splitlines()
    assert tuple(block[:2]) == report.HEAD
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in block[2:]]
    assert [row[0] for row in rows] == list(dict.fromkeys(fault.family for fault in every()))
    assert sum(int(row[1]) for row in rows) == len(every())
    assert report.insert(text, block) == text


def test_no_false_alarm():
    done = flight(1)
    assert done.ok, done
    assert done.level <= Level.WARN


@pytest.mark.faults
@pytest.mark.timeout(600)
def test_no_false_alarm_in_more_flights():
    """`clew faults nominal` flies a hundred."""
    alarms = [done for done in flights(6, 2, first_seed=2) if not done.ok]
    assert not alarms
