"""The whole system on real PX4 in software. Needs PX4_BIN, PX4's program built or installed for simulation; else skipped."""

import asyncio
import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from schemas.safety import Permit, Phase
from schemas.topics import ROBOT_POSE, SAFETY_STATE, SETPOINT, TRUTH, VEHICLE_IMU, VEHICLE_STATE
from schemas.vehicle import FlightMode
from services.console.cli import app
from services.faults import on_px4, report
from services.faults.catalogue import named
from services.recorder import reading, summary
from services.rehearsal import px4_flight
from services.rehearsal.chain import Flight, Stage
from services.rehearsal.quick import quicker
from services.simulator.human import Event, Kind
from tests.services import px4_chain, px4_fall

pytestmark = [
    pytest.mark.skipif(not px4_chain.PX4_BIN, reason="PX4_BIN is not set: no real PX4 to fly"),
    pytest.mark.timeout(300),
]


def vectors(messages, name):
    return np.array([getattr(m, name).array() for m in messages])


def stamps(messages):
    return np.array([m.stamp_ns for m in messages]) * 1e-9


def pull_after(flight: Flight, t_s: float) -> float:
    return pull_between(flight, t_s, np.inf)


def pull_between(flight: Flight, begin_s: float, end_s: float) -> float:
    messages = [m for m in flight.said[TRUTH.key] if begin_s < m.stamp_ns * 1e-9 < end_s]
    return float(np.max(np.linalg.norm(vectors(messages, "hand_force_N"), axis=1)))


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """The experiment once: the flight and its recorded session."""
    folder = tmp_path_factory.mktemp("px4")
    flight = px4_flight.fly(px4_chain.px4_config(folder), px4_flight.whole)
    return flight, reading.read(folder / "session.mcap")


def test_the_experiment_is_as_it_should_be(flown):
    flight, session = flown
    assert flight.phases()[-1] is Phase.LANDED
    result = summary.summarise(session)
    assert result.ok, result.reasons
    assert result.path_error.mean_m is not None
    assert result.path_error.mean_m < 0.035
    assert result.tracking_error.rms_m is not None
    assert result.tracking_error.rms_m < 0.04
    assert result.force_error.rms_n is not None
    assert result.force_error.rms_n < 0.08
    assert result.slack_fraction is not None
    assert result.slack_fraction < 0.02


def test_px4_gives_what_the_observer_needs(flown):
    """Inertial samples at 250 Hz with thrust and attitude; motor outputs in the range that the profile says."""
    flight, _ = flown
    samples = flight.said[VEHICLE_IMU.key]
    t = stamps(samples)
    assert len(t) / (t[-1] - t[0]) == pytest.approx(250.0, rel=0.03)
    walk = flight.during(VEHICLE_IMU.key, Phase.GUIDING)
    weight = flight.config.vehicle.quadrotor.mass_kg * 9.80665
    assert np.mean([m.thrust_N for m in walk]) == pytest.approx(weight + 1.0, abs=0.6)  # and the pull upwards


def test_px4_disarms_itself_after_the_landing_and_stays_so(flown):
    flight, _ = flown
    last = flight.said[VEHICLE_STATE.key][-1]
    assert not last.armed
    assert last.mode is not FlightMode.OFFBOARD


def test_a_person_who_lets_go_is_not_left_behind_by_a_runaway(tmp_path):
    config = quicker(px4_chain.px4_config(tmp_path))
    person = replace(config.person, behaviour=(Event(kind=Kind.LET_GO, start_s=6.0),))

    async def script(stage: Stage) -> None:
        await px4_flight.started(stage)
        await stage.until(lambda state: state.phase is Phase.GUIDING, 60.0)
        await stage.until(lambda state: not state.held, 30.0)
        await asyncio.sleep(4.0)

    flight = px4_flight.fly(config.model_copy(update={"person": person}), script)
    walked_ns = flight.during(TRUTH.key, Phase.GUIDING)[0].stamp_ns
    free = [m for m in flight.said[TRUTH.key] if not m.holding and m.stamp_ns > walked_ns]
    moved = vectors(free, "robot_position_m") - vectors(free[:1], "robot_position_m")
    assert np.max(np.linalg.norm(moved, axis=1)) < 0.6
    assert np.max(vectors(free, "robot_position_m")[:, 2]) < config.px4_bridge.flight.ceiling_m + 0.1


@pytest.mark.parametrize(
    "name",
    [
        "kill_force_estimator_in_guiding",
        "kill_safety_supervisor_in_guiding",
        "guidance_dropped",
        "clock_of_ground_plus_1s",
        "lets_go",
        "pilot_takes_over",
        "pilot_kills",
    ],
)
def test_a_fault_of_the_campaign_leads_to_what_it_must(tmp_path, name):
    """Of each kind one: `clew faults all --profile px4-sitl` flies them all."""
    fault = named(name)
    assert fault is not None
    (result,) = on_px4.campaign([fault], px4_chain.px4_config(tmp_path), tmp_path)
    assert result.ok, (result.broken, result.reasons)
    assert result.pull_before_N > 0.8, "nothing was pulling"


def test_the_campaign_writes_its_table_and_says_what_was_not_flown(tmp_path, monkeypatch):
    """As typed; of the faults two, the quickest."""
    chosen = (named("offboard_refused"), named("arming_denied"))
    monkeypatch.setattr(on_px4, "one_of_each", lambda: chosen)
    document = tmp_path / "safety.md"
    document.write_text("before\n" + "\n".join(report.PX4_TABLE) + "\nafter\n")
    pictures = tmp_path / "pictures"
    words = ["faults", "all", "--profile", "px4-sitl", "--into", str(document), "--pictures", str(pictures)]
    ended = CliRunner().invoke(app, words)
    assert ended.exit_code == 0, ended.output
    assert "1/2 offboard_refused: not flown: " in ended.output
    assert "2/2 arming_denied: kept" in ended.output
    assert "2 faults, 1 not flown, 0 with a broken promise" in ended.output
    before, *rows, after = document.read_text().splitlines()
    assert (before, after) == ("before", "after")
    assert [row.split("|")[1].strip() for row in rows[3:-1]] == ["offboard_refused", "arming_denied"]
    assert [file.name for file in pictures.iterdir()] == ["arming_denied.png"]


def test_after_a_loss_of_set_points_it_lands_and_is_not_flown_again(tmp_path):
    """PX4 would go back to offboard by itself on the first new set-point, if it only sank or held."""
    heard = []

    async def script(stage: Stage) -> None:
        await px4_flight.started(stage)
        await stage.until(lambda state: state.phase is Phase.ZEROING, 60.0)
        stage.flight.vehicle.mute = True
        heard.append(stage.operator.clock.now_ns() * 1e-9)
        await asyncio.sleep(2.0)
        stage.flight.vehicle.mute = False
        await asyncio.sleep(10.0)

    flight = px4_flight.fly(quicker(px4_chain.px4_config(tmp_path)), script)
    (cut_s,) = heard
    states = [m for m in flight.said[VEHICLE_STATE.key] if m.stamp_ns * 1e-9 > cut_s]
    left = next(m for m in states if m.mode is not FlightMode.OFFBOARD)
    assert left.mode is FlightMode.LAND
    assert left.stamp_ns * 1e-9 - cut_s < 1.2
    assert not states[-1].armed
    sent = [m for m in flight.said[SETPOINT.key] if m.stamp_ns > left.stamp_ns + 100_000_000]
    assert not sent


@pytest.mark.parametrize("phase", [Phase.ZEROING, Phase.GUIDING, Phase.ARRIVED])
def test_a_bridge_that_is_killed_leaves_nothing_armed(tmp_path, phase):
    """Its poses end with its set-points, so PX4 comes down blindly; by the barometer it feels the ground all the same."""
    fall = px4_fall.without_bridge(quicker(px4_chain.px4_config(tmp_path)), phase)
    assert fall.left_s < 1.2
    assert fall.pull_N < 0.3
    assert fall.down_s < 8.0
    assert fall.disarmed_s < 20.0


def test_without_motion_capture_nobody_is_pulled_and_it_comes_down(tmp_path):
    """PX4 dead-reckons for 4.7 s, then descends wherever it is; by then nothing pulls and the person has been told to let go."""
    gone = []

    async def script(stage: Stage) -> None:
        await px4_flight.started(stage)
        await stage.until(lambda state: state.phase is Phase.GUIDING, 60.0)
        await asyncio.sleep(3.0)
        stage.tasks.pop("tracker").cancel()
        gone.append(stage.operator.clock.now_ns() * 1e-9)
        await asyncio.sleep(18.0)

    flight = px4_flight.fly(quicker(px4_chain.px4_config(tmp_path)), script)
    (t,) = gone
    assert not [m for m in flight.said[ROBOT_POSE.key] if m.stamp_ns * 1e-9 > t + 0.1]
    descends = next(m for m in flight.said[VEHICLE_STATE.key] if m.mode is FlightMode.LAND).stamp_ns * 1e-9
    assert descends - t < 5.5
    assert pull_between(flight, t, descends) < 2.5
    assert pull_between(flight, t + 1.5, descends) < 1.0
    assert pull_after(flight, descends) < 1.0
    permits = {m.permit for m in flight.said[SAFETY_STATE.key] if m.stamp_ns * 1e-9 > t + 1.5}
    assert Permit.GUIDE not in permits
    assert flight.said[TRUTH.key][-1].robot_position_m.z < 0.3
    assert not flight.said[VEHICLE_STATE.key][-1].armed


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one processor is not enough for real time")
def test_the_command_flies_it_too(tmp_path):
    """`clew demo --profile px4-sitl` in real time, as processes; a starved host may spoil the figures, not the flight."""
    environment = os.environ | {"CLEW_RUN_DIR": str(tmp_path / "run")}
    command = [
        sys.executable,
        "-P",
        "-m",
        "services.console.cli",
        "demo",
        "--profile",
        "px4-sitl",
        "--no-live",
        "--out",
        str(tmp_path),
    ]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=200)
    assert ended.returncode in (0, 1), ended.stderr
    folder = tmp_path / "latest"
    result = json.loads((folder / "summary.json").read_text())
    assert "landed" in result["durations_s"]
    assert "Startup script returned successfully" in (folder / "logs" / "px4.log").read_text(errors="replace")
    if result["host_stalls"] == 0:
        assert result["ok"], result["reasons"]
