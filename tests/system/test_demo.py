"""One whole flight as a user gets it: every service a process, real Zenoh and MAVSDK between them, real time."""

import json
import subprocess
from functools import reduce
from operator import getitem

import pytest

from schemas.topics import HEALTH, SETPOINT
from services.console.rerun import config_with
from services.recorder.reading import read
from services.recorder.rerun import rerun
from services.recorder.rerun_subjects import SUBJECTS
from services.simulator.autopilot import STEP_S
from tests.system.demo_profile import run, write_profile

STARVED = 0.01
"""Share of the simulated world's periods that were missed: beyond it the host could not keep the world in real time."""


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """One demo. A flight that fails on a host which cannot keep real time says nothing about the system: skipped, by name."""
    folder = tmp_path_factory.mktemp("demo")
    ended = run(folder, "demo", "--no-live", "--profile", str(write_profile(folder)), timeout_s=200.0)
    session = folder / "sessions/latest"
    if (ended.returncode or beyond(session)) and (missed := missed_share(session / "session.mcap")) > STARVED:
        pytest.skip(f"the host took the processor away: the simulated world missed {missed:.0%} of its periods")
    return folder, ended


def beyond(session) -> list[str]:
    """What of the flight is not as it must be."""
    if not (file := session / "summary.json").exists():
        return ["no summary"]
    summary = json.loads(file.read_text())
    limits = {
        "path_error.mean_m": 0.035,
        "path_error.max_m": 0.065,
        "end_error_m": 0.10,
        "slack_fraction": 0.02,
        "hand_force.max_n": 2.5,
        "messages_lost": 0.5,
        "force_error.rms_n": 0.08,
        "tracking_error.rms_m": 0.04,
    }
    values = {name: reduce(getitem, name.split("."), summary) for name in limits}
    return summary["reasons"] + [
        f"{name} = {value}" for name, value in values.items() if value is None or value >= limits[name]
    ]


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
    assert not beyond(folder / "sessions/latest")


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
