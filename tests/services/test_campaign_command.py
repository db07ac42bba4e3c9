"""`clew campaign` without its command line: what it leaves behind, what stops it, and how it goes on."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from services.campaign import batch, recorded
from services.campaign.command import Options, campaign
from services.guiding_controller import path_file
from services.recorder import reading, summary
from tests.services import synthetic

pytestmark = pytest.mark.slow


def short(out: Path, **changed) -> Options:
    return replace(Options(people=3, trials=2, seconds=1.0, population="general", out=out), **changed)


def rows(file: Path) -> list[dict[str, str]]:
    with file.open(newline="") as lines:
        return list(csv.DictReader(lines))


def test_it_leaves_figures_page_tables_and_summary(tmp_path, capsys):
    assert campaign(short(tmp_path / "a", people=13, vary="delay_ms=0,20")) == 0
    assert "26 walks of 13 persons" in capsys.readouterr().out
    runs = rows(tmp_path / "a" / "runs.csv")
    assert [(run["person"], run["trial"]) for run in runs[:3]] == [("1", "1"), ("1", "2"), ("2", "1")]
    assert {run["delay_ms"] for run in runs} == {"0", "20"}
    assert all(0.5 < float(run["force_max_N"]) < 5.0 for run in runs)
    assert len(rows(tmp_path / "a" / "errors.csv")) == 401
    page = (tmp_path / "a" / "index.html").read_text()
    assert page.count("data:image/png;base64,") == 2
    assert 'src="http' not in page
    assert json.loads((tmp_path / "a" / "summary.json").read_text())["walks"] == 26
    with np.load(tmp_path / "a" / "traces.npz") as traces:
        assert traces["run_00000"].shape == (10, 2)


def test_the_same_plan_gives_the_same_walks_in_whatever_batches_and_processes(tmp_path):
    assert campaign(short(tmp_path / "one")) == 0
    assert campaign(short(tmp_path / "two", jobs=2)) == 0
    assert len(list((tmp_path / "two" / "batches").iterdir())) == 2
    for a, b in zip(rows(tmp_path / "one" / "runs.csv"), rows(tmp_path / "two" / "runs.csv"), strict=True):
        assert a.keys() == b.keys()
        for name in a:
            assert (a[name], b[name]) == ("", "") or float(a[name]) == pytest.approx(float(b[name]), abs=1e-7)


def test_an_interrupted_campaign_keeps_what_is_finished_and_goes_on(tmp_path, monkeypatch, capsys):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    monkeypatch.setattr("services.campaign.command.BATCH", 2)
    assert campaign(short(whole)) == 0
    run = batch.run
    monkeypatch.setattr(batch, "run", _interrupted_at(1, run))
    assert campaign(short(cut)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "1 of 3 batches are kept" in line
    assert f"--resume --out {cut}" in line
    first = (cut / "batches" / "00000.npz").stat().st_mtime_ns
    monkeypatch.setattr(batch, "run", run)
    assert campaign(short(cut)) == 2  # not by accident
    assert campaign(Options(out=cut, resume=True)) == 0
    assert (cut / "batches" / "00000.npz").stat().st_mtime_ns == first
    assert (cut / "runs.csv").read_text() == (whole / "runs.csv").read_text()


def _interrupted_at(which, run):
    def interrupted(folder, index, progress):
        if index == which:
            raise KeyboardInterrupt
        run(folder, index, progress)

    return interrupted


PATH_OUTSIDE = """
name = "far"
waypoints_m = [[0.0, 0.0], [4.0, 0.0], [9.0, 0.0]]
[force]
f_start_N = 0.75
f_max_N = 1.5
ramp_up_fraction = 0.1
ramp_down_fraction = 0.15
"""


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"trials": 0}, "--trials = 0: must be at least 1"),
        ({"people": 0}, "--people = 0: must be at least 1"),
        ({"jobs": 0}, "--jobs = 0: must be at least 1"),
        ({"seconds": float("nan")}, "--seconds = nan: must be 1 to 3600"),
        ({"controller": "magic"}, "--controller = magic: must be one of reference, literal, regulation"),
        ({"robot": "balloon"}, "--robot = balloon: must be one of ideal, px4"),
        ({"population": "nobody"}, "--population = nobody: no such file"),
        ({"vary": "m_H=-2..3"}, "--vary m_H = -2: must be > 0: everybody has a mass"),
        ({"vary": "f_z=100"}, "must be below m_H g ="),
        ({"path": "outside.toml"}, "outside world.volume"),
        ({"sessions": [Path("none.mcap")]}, "none.mcap"),
        ({"resume": True}, "campaign.json"),
    ],
)
def test_bad_input_is_one_line_before_anybody_walks(tmp_path, monkeypatch, capsys, changed, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "outside.toml").write_text(PATH_OUTSIDE)
    assert campaign(short(tmp_path / "out", **changed)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    assert not list(tmp_path.glob("out/**/*.npz"))


def test_a_folder_that_cannot_be_written_is_said(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert campaign(short(tmp_path / "file" / "out")) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"--out = {tmp_path / 'file' / 'out'}: cannot be written" in line


def test_recorded_sessions_have_the_same_statistics(tmp_path):
    files = [synthetic.write(tmp_path / f"{name}.mcap") for name in "ab"]
    assert campaign(Options(sessions=files, out=tmp_path / "out")) == 0
    runs = rows(tmp_path / "out" / "runs.csv")
    alone = summary.summarise(reading.read(files[0]))
    assert [(run["person"], run["trial"]) for run in runs] == [("1", "1"), ("1", "2")]
    for run in runs:
        assert float(run["error_mean_m"]) == pytest.approx(alone.path_error.mean_m, abs=1e-6)
        assert float(run["error_max_m"]) == pytest.approx(alone.path_error.max_m, abs=1e-6)
        assert float(run["end_error_m"]) == pytest.approx(alone.end_error_m, abs=1e-6)


def test_recordings_along_different_paths_are_not_mixed(tmp_path, capsys, monkeypatch):
    files = [synthetic.write(tmp_path / f"{name}.mcap") for name in "ab"]
    read = recorded.path_of
    other = path_file.read(Path(__file__).parents[2] / "deploy" / "paths" / "straight.toml", 1.0)
    paths = iter((read(reading.read(files[0])), other))
    monkeypatch.setattr(recorded, "path_of", lambda _: next(paths))
    assert campaign(Options(sessions=files, out=tmp_path / "out")) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{files[1]}: path = straight: must be the same as paper of {files[0]}" in line
