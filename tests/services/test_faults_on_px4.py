"""What the campaign on PX4 does without a PX4: which faults, what is said of them, and what a user is told."""

from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from services.config import load
from services.console.cli import app
from services.faults import measure, on_px4, report
from services.faults.catalogue import every, named
from services.faults.fault import GUIDING, OnPx4
from services.simulator.px4_process import Px4NotThere

LATE = OnPx4(late_s=2.0, late="it filters")


def fault_of(name: str):
    found = named(name)
    assert found is not None
    return found


def test_one_of_each_family_is_flown_in_the_guided_walk_where_it_has_one_there():
    chosen = on_px4.one_of_each()
    families = [fault.family for fault in chosen]
    left = {fault.family for fault in every()} - set(families)
    assert len(set(families)) == len(families) > 45
    assert len(left) == 13
    assert all(family.endswith(("in disorder", "stands still", "restarted")) for family in left)
    assert not [family for family in left if family.startswith("px4_bridge")]
    there = {fault.family for fault in every() if fault.moment is GUIDING}
    assert len(there) > 40
    assert all(fault.moment is GUIDING for fault in chosen if fault.family in there)


def test_what_px4_cannot_be_made_to_do_is_said_and_not_flown(tmp_path):
    fault = fault_of("offboard_refused")
    (result,) = on_px4.campaign([fault], load("px4-sitl"), tmp_path)
    assert result.verdict == "not flown: on the ground PX4 takes offboard mode from anybody"
    assert not list(tmp_path.iterdir())
    row = report.written([fault], [result])[-1]
    assert row.startswith("| offboard_refused | 0 | stays on the ground | - |")
    assert row.endswith(f"| {result.verdict} |")
    assert row.count("|") == report.HEAD[0].count("|")


def test_a_flight_that_fails_is_a_broken_promise(tmp_path):
    """Here there is no PX4 in the program."""
    config = load("px4-sitl", px4="/bin/true")
    assert config.simulator.px4_sitl is not None
    aside = replace(config.simulator.px4_sitl, instance=1)  # its ports are no other test's
    config = config.model_copy(update={"simulator": replace(config.simulator, px4_sitl=aside)})
    (result,) = on_px4.campaign([fault_of("clew_stop")], config, tmp_path)
    assert not result.ok
    assert result.verdict.startswith(Px4NotThere.__module__)
    assert "no PX4 for simulation" in result.verdict


@pytest.mark.parametrize(
    ("reaction_s", "kept", "excuse"),
    [(0.9, True, ""), (2.5, True, "land after 2.50 s, promised 1 s (it filters)")],
)
def test_who_may_be_late_keeps_the_promise_and_the_excuse_is_said(reaction_s, kept, excuse):
    fault = replace(fault_of("clew_land"), within_s=1.0, on_px4=LATE)
    measured = replace(measure.not_flown(fault, ""), within_s=3.0, reaction_s=reaction_s)
    result = on_px4.excused(fault, measured)
    assert (result.ok, result.within_s) == (kept, 1.0)
    assert result.exempt == ((excuse,) if excuse else ())


def test_later_than_that_is_broken_and_not_excused():
    fault = replace(fault_of("clew_land"), within_s=1.0, on_px4=LATE)
    measured = replace(measure.not_flown(fault, ""), reaction_s=3.5, broken=("land after 3.50 s, promised 3 s",))
    assert on_px4.excused(fault, measured).broken == measured.broken
    assert not on_px4.excused(fault, measured).exempt


def test_the_table_on_px4_in_the_documentation_is_of_this_catalogue():
    begin, end = report.PX4_TABLE
    text = (Path(__file__).parents[2] / "docs/safety.md").read_text()
    block = text.split(begin)[1].split(end)[0].strip().splitlines()
    assert tuple(block[:2]) == report.HEAD
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in block[2:]]
    chosen = on_px4.one_of_each()
    assert [row[0] for row in rows] == [fault.family for fault in chosen]
    assert [row[1] == "0" for row in rows] == [bool(fault.on_px4.not_flown) for fault in chosen]
    assert report.insert(text, block, report.PX4_TABLE) == text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["run", "nothing"], "no fault 'nothing'; clew faults list shows them"),
        (["run", "lets_go", "--px4", "/bin/true"], "the profile demo does not fly PX4: --profile px4-sitl does"),
        (["run", "lets_go", "--profile", "px4-sitl"], "give its program by --px4 or PX4_BIN"),
        (["all", "--profile", "px4-sitl", "--px4", "/bin/true"], "/bin/true: no PX4 for simulation"),
        (["all", "--profile", "drone-sim"], "drone-sim: faults are flown on one host"),
    ],
)
def test_bad_input_is_one_line_before_anything_flies(words, said, monkeypatch, tmp_path):
    monkeypatch.delenv("PX4_BIN", raising=False)
    monkeypatch.chdir(tmp_path)
    ended = CliRunner().invoke(app, ["faults", *words])
    assert ended.exit_code == 2
    (line,) = ended.stderr.splitlines()
    assert said in line
    assert not list(tmp_path.iterdir())


def test_the_list_says_what_px4_flies(monkeypatch):
    monkeypatch.setenv("COLUMNS", "250")
    told = CliRunner().invoke(app, ["faults", "list"]).stdout
    assert told.count("in all") == sum(not fault.on_px4.not_flown for fault in on_px4.one_of_each())
    assert "not: on the ground PX4" in told
