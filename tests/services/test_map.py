"""`clew map` as a person types it: what it writes, and what it says to bad input before anything flies."""

import csv
import inspect

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.campaign import stability_map
from services.campaign.stability_map import Asked
from services.campaign.values import Limits, values
from services.console import cli

pytestmark = pytest.mark.slow

GOOD = Asked(vehicle="light", ratio="1", k_c="200", seconds=4.0)


def test_it_prints_every_cell_with_its_verdict_and_what_is_assumed(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(stability_map, "FREQUENCY_HZ", np.array([1.7]))
    asked = GOOD._replace(vehicle="medium", ratio="0.53,1", delay_ms="0,9", lead_s=0.0)
    assert stability_map.run(asked, tmp_path / "new" / "map") == 0
    told = capsys.readouterr().out
    assert "slack" in told
    assert "calm" in told
    assert "refuses" in told
    assert "Assumed" in told
    assert (tmp_path / "new" / "map" / "stability_map.png").stat().st_size > 10_000
    with (tmp_path / "new" / "map" / "stability_map.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 2
    assert {float(row["delay_ms"]) for row in rows} == {0.0, 8.0}  # whole ticks
    (measured,) = [row for row in rows if row["real_px4_std_N"] and row["M_A_over_m_R"] == "1"]
    assert (measured["vehicle"], measured["real_px4_std_N"]) == ("medium", "0.09")


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("vehicle", "heavy", "heavy: no such file, and not one of light, medium"),
        ("profile", "nowhere", "nowhere: no such file"),
        ("ratio", "0", "--ratio = 0: 0 must be between 0.1 and 10"),
        ("ratio", "one", "--ratio = 'one': numbers are needed"),
        ("k_c", "50,,100", "--k-c = '': numbers are needed"),
        ("k_c", "nan", "--k-c = nan: nan must be between 1 and 5000"),
        ("k_c", "1..2..3", "--k-c = '1..2..3': numbers are needed"),
        ("observer_hz", "-2..20", "--observer-hz = -2..20: -2 must be between 0.5 and 60"),
        ("delay_ms", "0..200", "must be between 0 and 100"),
        ("delay_ms", "0..100:26", "26 pairs of observer-hz and delay-ms: at most 24"),
        ("k_c", "1..5000:6000", "6000 cells: at most 5000"),
        ("lead_s", -0.1, "--lead-s = -0.1: must be between 0 and 1"),
        ("d_c", -1.0, "--d-c = -1: must be between 0 and 100"),
        ("seconds", 0.0, "--seconds = 0: must be between 4 and 120"),
        ("seconds", float("nan"), "--seconds = nan: must be between 4 and 120"),
    ],
)
def test_bad_input_is_one_line_and_exit_2_before_anything_is_written(tmp_path, capsys, key, value, said):
    assert stability_map.run(GOOD._replace(**{key: value}), tmp_path / "map") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("clew map: ")
    assert said in line
    assert not (tmp_path / "map").exists()


def test_a_folder_that_cannot_be_is_said(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert stability_map.run(GOOD, tmp_path / "file" / "map") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"--out = {tmp_path}/file/map: " in line


def test_the_commands_defaults_are_the_maps():
    """One truth: what `clew map` flies without options is what `Asked` says."""
    told = inspect.signature(cli.stability_map).parameters
    assert {key: told[key].default for key in Asked._fields} == Asked()._asdict()


@given(st.floats(0.5, 20.0), st.floats(21.0, 60.0), st.integers(2, 9))
def test_ranges_are_evenly_spaced_and_lists_are_sorted(low, high, n):
    limits = Limits(0.0, 100.0)
    assert values("--x", f"{low}..{high}:{n}", limits) == pytest.approx(np.linspace(low, high, n))
    assert len(values("--x", f"{low}..{high}", limits)) == 5
    assert values("--x", f"{high}, {low},{high}", limits) == pytest.approx([low, high])
