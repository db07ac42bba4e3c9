"""The campaign of faults: some of each kind in every run of the suite, all in `make test-faults`; and flights without any."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from schemas.safety import Level
from services.faults import report
from services.faults.campaign import alone, campaign, processors, unremarked
from services.faults.catalogue import every, named
from services.faults.fault import GUIDING
from services.faults.measure import Result, measure
from services.faults.nominal import flight, flights

QUICK_S = 12.0
FLOWN = {
    fault.family: fault
    for fault in sorted(every(), key=lambda fault: fault.moment is GUIDING)
    if fault.watch_s <= QUICK_S and not fault.alone
}
"""One of each family that does not take long, in the guided walk where it has one there."""


@pytest.fixture(scope="module")
def results() -> dict[str, Result]:
    return {result.name: result for result in campaign(list(FLOWN.values()), processors())}


@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", [fault.name for fault in FLOWN.values()])
def test_what_must_hold_holds(results, name):
    assert results[name].ok, (results[name].broken, results[name].reasons)


@pytest.mark.parametrize("family", ["force/cable wrong", "lifts_the_hand"])
def test_what_is_flown_in_a_copy_is_what_is_flown_alone(results, family):
    """In every number: a fault of the bus, and a person's deed."""
    with unremarked():
        assert measure(FLOWN[family], *alone(FLOWN[family])) == results[FLOWN[family].name]


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


def test_a_fault_that_cannot_be_flown_is_no_success():
    fault = named("clew_stop")
    assert fault is not None

    def fails(stage):
        raise ValueError("no such knob")

    (result,) = campaign([replace(fault, act=fails)])
    assert result.broken == ("ValueError: no such knob",)


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
@pytest.mark.timeout(900)
def test_what_must_hold_holds_in_every_fault():
    broken = {result.name: result.broken for result in campaign(every(), processors()) if not result.ok}
    assert not broken


@pytest.mark.faults
@pytest.mark.timeout(600)
def test_no_false_alarm_in_many_flights():
    """`clew faults nominal` flies a hundred."""
    alarms = [done for done in flights(20, 2, first_seed=2) if not done.ok]
    assert not alarms
