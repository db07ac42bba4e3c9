"""One whole flight as a user gets it: every service a process, real Zenoh and MAVSDK between them, real time."""

import json
import subprocess

import pytest

from schemas.topics import HEALTH, SETPOINT
from services.console.rerun import config_with
from services.recorder.reading import read
from services.recorder.rerun import SUBJECTS, rerun
from services.simulator.autopilot import STEP_S
from tests.system.demo_profile import run, write_profile

STARVED = 0.01
"""Share of the simulated world's periods that were missed: beyond it the host could not keep the world in real time."""


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """One demo. A flight that fails on a host which cannot keep real time says nothing about the system: skipped, by name."""
    folder = tmp_path_factory.mktemp("demo")
    ended = run(folder, "demo", "--no-live", "--profile", str(write_profile(folder)), timeout_s=200.0)
    if ended.returncode and (missed := missed_share(folder / "sessions/latest/session.mcap")) > STARVED:
        pytest.skip(f"the host took the processor away: the simulated world missed {missed:.0%} of its periods")
    return folder, ended


def missed_share(recording) -> float:
    """Of the simulator's periods, by its own heartbeats; 0 where there is nothing to read."""
    if not recording.exists():
        return 0.0
    session = read(recording)
    beats = session.table(HEALTH["simulator"])
    periods = session.duration_s / STEP_S
    return float(beats["missed_periods"][-1]) / periods if len(beats["missed_periods"]) else 0.0


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
    for name in ("path.png", "time.png", "energy.png", "timing.png"):
        assert (session / name).stat().st_size > 10_000
    recording = read(session / "session.mcap")
    assert recording.damage == ""
    assert recording.verdict.closed
    sent = recording.messages(SETPOINT)
    assert any({"force/cable", "guidance/command", "safety/state"} <= set(m.inputs) for m in sent)


@pytest.mark.parametrize("service", SUBJECTS)
def test_its_services_say_the_same_bytes_when_they_run_again(demo, service):
    """A loaded host misses periods and loses time between messages: all of that is in the recording."""
    folder, _ = demo
    file = folder / "sessions/latest/session.mcap"
    session = read(file)
    outcome = rerun(session, service, config_with(session, file, []))
    assert outcome.first is None, str(outcome.first)
    assert outcome.equal, outcome.notes


def test_nothing_is_left_running(demo):
    folder, _ = demo
    found = subprocess.run(["pgrep", "-f", str(folder)], capture_output=True, text=True, check=False)
    assert found.stdout == ""
