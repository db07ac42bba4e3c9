"""A session with known answers gives those answers; a bad one says what was bad; figures and report come from both."""

import io
import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from rich.console import Console

from schemas.guidance import GuidanceCommand
from schemas.message import Message, Vec3
from schemas.topics import GUIDANCE, HANDLE_STATE, MOCAP_FRAME, SETPOINT, TOPICS
from schemas.tracking import HandleSource, HandleState, MocapFrame, RigidBody
from schemas.vehicle import Setpoint, SetpointKind
from services.config import load
from services.console.report import show
from services.recorder.alarms import alarms
from services.recorder.figures import FIGURES, draw_all
from services.recorder.latency import reactions
from services.recorder.reading import read
from services.recorder.summary import summarise
from services.recorder.walk import CONFIG_ATTACHMENT
from services.recorder.writer import SessionWriter
from tests.services import synthetic, synthetic_world
from tests.services.synthetic_world import Scenario


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("sessions")


@pytest.fixture(scope="module")
def good(folder):
    return read(synthetic.write(folder / "good.mcap"))


@pytest.fixture(scope="module")
def bad(folder):
    """Drifts 8 cm, goes slack for 0.5 s of 5, loses messages and does not land; no truth, seen by the sensors alone."""
    scenario = Scenario(drift_m=0.08, slack_s=(2.0, 2.5), dropped={GUIDANCE.key: {7, 8, 30}}, lands=False, truth=False)
    return read(synthetic.write(folder / "bad.mcap", scenario))


def test_what_limited_a_flight_is_told_in_the_words_of_then():
    states = {
        "t_s": np.array([0.0, 1.0, 2.0, 3.0, 4.0]),
        "level": np.array([0, 2, 2, 3, 0]),
        "phase": np.array(["guiding", "guiding", "guiding", "hold", "guiding"]),
        "reasons": np.array([[], ["a"], ["a"], ["b", "a"], []], dtype=object),
    }
    said = [(alarm.begin_s, alarm.end_s, alarm.level.name, alarm.text) for alarm in alarms(states)]
    assert said == [(1.0, 3.0, "EASE", "a"), (3.0, 4.0, "HOLD", "b; a")]


def test_the_numbers_of_a_good_session_are_those_it_was_made_with(good):
    scenario, summary = Scenario(), summarise(good)
    assert summary.reasons == []
    assert summary.ok
    assert summary.from_truth
    assert summary.path_error.mean_m == pytest.approx(scenario.drift_m * 2.0 / np.pi, rel=0.005)
    assert summary.path_error.max_m == pytest.approx(scenario.drift_m, rel=0.001)
    assert summary.end_error_m == pytest.approx(0.0, abs=1e-6)
    assert summary.slack_fraction == 0.0
    assert summary.force_error.rms_n == pytest.approx(np.hypot(*scenario.force_bias_N[1:]), rel=0.01)
    assert summary.tracking_error.rms_m == pytest.approx(np.hypot(0.03, 0.04), rel=0.01)
    assert summary.host_stalls == scenario.stalls
    assert summary.messages_lost == 0
    assert summary.messages == sum(len(log.payloads) for log in good.logs.values())
    assert summary.durations_s["guiding"] == pytest.approx(scenario.guiding_s, abs=0.011)
    assert summary.services["tracker"].missed_periods == 3


def test_head_and_hand_are_as_far_and_as_hard_pressed_as_they_were_made(good):
    world = synthetic_world.World(Scenario())
    t = np.arange(0.05, world.end_s, 0.01)
    p_H = world.handle(t)
    distance = np.sqrt(np.sum((world.robot(t) - p_H - (-0.35, 0.1, 0.6)) ** 2, axis=-1))[world.held(t)]
    pull = (world.force(t) - (0.0, 0.0, synthetic_world.WEIGHT_N))[world.held(t)]
    summary, tip_m = summarise(good), load("demo").safety_supervisor.envelope.rotor_tip_m
    assert summary.head_clearance_m == pytest.approx(np.min(distance) - tip_m, abs=1e-6)
    assert summary.hand_force.max_n == pytest.approx(np.max(np.sqrt(np.sum(pull**2, axis=-1))), abs=1e-6)


def test_a_bad_session_is_not_ok_and_every_reason_is_named(bad):
    summary = summarise(bad)
    assert not summary.ok
    assert not summary.from_truth
    assert summary.force_error.rms_n is None
    assert summary.head_clearance_m is None
    assert summary.slack_fraction == pytest.approx(0.1, abs=0.01)
    assert summary.messages_lost == 3
    said = "\n".join(summary.reasons)
    for reason in ("path_error.mean_m", "path_error.max_m", "slack_fraction", "messages_lost = 3", "not disarmed"):
        assert reason in said
    assert "hand_force" not in said


@pytest.mark.parametrize(("host", "lost", "on_radio"), [("drone", 0, 3), ("ground", 3, 0)])
def test_what_a_radio_lost_is_told_and_not_judged(bad, host, lost, on_radio):
    """What is missing here is the guiding controller's, which is on the ground."""
    session = read(bad.file)
    both = {name: {"services": list(each.services)} for name, each in load("drone").hosts.items()}
    config = json.loads(session.attachments[CONFIG_ATTACHMENT]) | {"hosts": both, "system": {"host": host}}
    session.attachments = {**session.attachments, CONFIG_ATTACHMENT: json.dumps(config).encode()}
    summary = summarise(session)
    assert (summary.messages_lost, summary.messages_lost_on_radio) == (lost, on_radio)
    assert any("messages_lost" in reason for reason in summary.reasons) is (host == "ground")


def test_a_session_that_was_cut_off_is_not_ok_but_is_summarised(folder, good):
    data = (folder / "good.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(data[: len(data) // 2])
    summary = summarise(read(folder / "cut.mcap"))
    assert not summary.ok
    assert summary.messages_lost == 0
    assert 0.01 < (summary.path_error.max_m or 0.0) <= 0.03
    assert any("cut off" in reason for reason in summary.reasons)
    assert any("not landed" in reason for reason in summary.reasons)


def test_a_recording_of_nothing_is_summarised_as_unknown(folder):
    summary = summarise(_empty(folder / "empty.mcap"))
    assert not summary.ok
    assert summary.path_error.mean_m is None
    assert summary.hand_force.max_n is None
    assert summary.latency == {}
    assert any("path_error.mean_m = unknown" in reason for reason in summary.reasons)


def test_the_json_has_the_agreed_keys(good):
    raw = json.loads(summarise(good).to_json())
    assert {"mean_m", "max_m"} == raw["path_error"].keys()
    assert raw["hand_force"].keys() == {"max_n"}
    assert raw["force_error"].keys() == {"rms_n"}
    assert raw["tracking_error"].keys() == {"rms_m"}
    assert {"end_error_m", "slack_fraction", "messages_lost", "host_stalls", "ok"} <= raw.keys()


def test_latency_is_that_of_the_first_set_point_that_contains_a_sample(tmp_path):
    """Two captures, at 10 and 30 ms; the first reaches set-points at 17 and 25 ms, the second one at 41 ms."""
    ms = 1_000_000
    body = RigidBody(tracked=True)
    said: list[tuple[str, Message]] = [
        (MOCAP_FRAME.key, MocapFrame(seq=1, stamp_ns=10 * ms, robot=body, handle=body)),
        (HANDLE_STATE.key, handle(seq=1, stamp_ns=12 * ms, inputs={"mocap/frame": 1})),
        (GUIDANCE.key, guidance(seq=1, stamp_ns=15 * ms, inputs={"handle/state": 1})),
        (SETPOINT.key, setpoint(seq=1, stamp_ns=9 * ms, inputs={})),
        (SETPOINT.key, setpoint(seq=2, stamp_ns=17 * ms, inputs={"guidance/command": 1})),
        (SETPOINT.key, setpoint(seq=3, stamp_ns=25 * ms, inputs={"guidance/command": 1})),
        (MOCAP_FRAME.key, MocapFrame(seq=2, stamp_ns=30 * ms, robot=body, handle=body)),
        (HANDLE_STATE.key, handle(seq=2, stamp_ns=33 * ms, inputs={"mocap/frame": 2})),
        (GUIDANCE.key, guidance(seq=2, stamp_ns=35 * ms, inputs={"handle/state": 2})),
        (SETPOINT.key, setpoint(seq=4, stamp_ns=41 * ms, inputs={"guidance/command": 2})),
    ]
    with SessionWriter(tmp_path / "a.mcap", TOPICS, epoch_ns=synthetic.EPOCH_NS, chunk_bytes=1000) as session:
        for key, message in said:
            session.add(key, message.model_dump_json().encode(), message.stamp_ns)
    delays = {stage: (1e3 * delay).round(3).tolist() for stage, delay in reactions(read(tmp_path / "a.mcap")).items()}
    assert delays == {
        "simulator -> tracker": [2.0, 3.0],
        "tracker -> guiding_controller": [3.0, 2.0],
        "guiding_controller -> px4_bridge": [2.0, 6.0],
        "total": [7.0, 11.0],
    }


def handle(**head):
    return HandleState(**head, position_m=Vec3(), velocity_mps=Vec3(), source=HandleSource.MOCAP, lag_s=0.0)


def guidance(**head):
    zero = dict.fromkeys(("p_H_d_m", "p_R_d_m", "f_d_N", "u_A_N"), Vec3())
    return GuidanceCommand(**head, **zero, s=0.0, path_length_m=4.0, scale=1.0, path_error_m=0.0)


def setpoint(**head):
    zero = dict.fromkeys(("position_m", "velocity_mps", "acceleration_mps2", "u_R_mps2", "u_A_N"), Vec3())
    return Setpoint(**head, **zero, kind=SetpointKind.ADMITTANCE, yaw_rad=0.0, feed_forward=1.0, age_s=0.0)


@pytest.mark.parametrize("name", ["good", "bad", "empty"])
def test_figures_are_drawn_of_every_recording_without_a_warning(name, folder, good, bad):
    session = {"good": good, "bad": bad}.get(name) or _empty(folder / "nothing.mcap")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        files = draw_all(session, folder / name)
    assert [file.name for file in files] == list(FIGURES)
    for file in files:
        pixels = imread(file)
        assert pixels.shape[1] == 1750  # 7 inches at 250 dots
        assert np.ptp(pixels[..., :3]) == 1.0  # black on white


def _empty(file):
    SessionWriter(file, TOPICS, epoch_ns=0, chunk_bytes=1000).close()
    return read(file)


def test_the_report_shows_numbers_limits_and_reasons(good, bad):
    text = _shown(good)
    assert "1.91 cm" in text
    assert "3.5 cm" in text
    assert "as it should be" in text
    assert "not as it should be" not in text
    assert "sessions/1" in text
    worse = _shown(bad)
    assert "not as it should be:" in worse
    assert "messages_lost = 3" in worse
    assert "unknown" in worse  # the force error, without truth


def _shown(session):
    screen = io.StringIO()
    show(summarise(session), Path("sessions/1"), Console(width=80, file=screen))
    return screen.getvalue()
