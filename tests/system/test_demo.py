"""One whole flight as a user gets it: every service a process, real Zenoh and MAVSDK between them, real time."""

import json
import subprocess

import pytest

from schemas.topics import SETPOINT
from services.recorder.reading import read
from tests.system.demo_profile import run, write_profile


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo")
    ended = run(folder, "demo", "--no-live", "--profile", str(write_profile(folder)), timeout_s=200.0)
    return folder, ended


@pytest.mark.timeout(240)
def test_the_demo_flies_from_take_off_to_landing(demo):
    folder, ended = demo
    assert ended.returncode == 0, ended.stdout[-3000:] + ended.stderr[-3000:]
    summary = json.loads((folder / "sessions/latest/summary.json").read_text())
    assert summary["ok"], summary["reasons"]
    assert summary["path_error"]["mean_m"] < 0.035
    assert summary["path_error"]["max_m"] < 0.065
    assert summary["end_error_m"] < 0.10
    assert summary["slack_fraction"] < 0.02
    assert summary["hand_force"]["max_n"] < 2.5
    assert summary["messages_lost"] == 0
    assert summary["force_error"]["rms_n"] < 0.08
    assert summary["tracking_error"]["rms_m"] < 0.04


def test_it_leaves_figures_and_a_recording_that_names_causes(demo):
    folder, _ = demo
    session = folder / "sessions/latest"
    for name in ("path.png", "time.png", "timing.png"):
        assert (session / name).stat().st_size > 10_000
    recording = read(session / "session.mcap")
    assert recording.damage == ""
    assert recording.verdict.closed
    sent = recording.messages(SETPOINT)
    assert any({"force/cable", "guidance/command", "safety/state"} <= set(m.inputs) for m in sent)


def test_nothing_is_left_running(demo):
    folder, _ = demo
    found = subprocess.run(["pgrep", "-f", str(folder)], capture_output=True, text=True, check=False)
    assert found.stdout == ""
