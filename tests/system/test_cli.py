"""The command line as a person meets it: looking at a running system, stopping it, and what goes wrong at start."""

import json
import os
import re
import signal
import socket
import time

import pytest

from schemas.topics import NOTE
from services.config import load
from services.recorder.inspection import inspect
from services.recorder.reading import read
from tests.system.demo_profile import clew, free_port, run, write_profile

UP = re.compile(r"^up: ", re.MULTILINE)


def found(pattern: str, text: str) -> str:
    """The first group of a pattern that must be there."""
    match = re.search(pattern, text)
    assert match, f"{pattern} is not in:\n{text}"
    return match[1]


@pytest.fixture(scope="module")
def system(tmp_path_factory):
    """`clew up`, running; its folder and profile."""
    folder = tmp_path_factory.mktemp("up")
    profile = write_profile(folder)
    process = clew(folder, "up", str(profile))
    assert process.stdout
    assert process.stderr
    line = process.stdout.readline()
    assert UP.match(line), line + process.stderr.read()
    yield folder, str(profile), process
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def test_status_names_every_service_and_what_limits_the_system(system):
    folder, profile, _ = system
    ended = run(folder, "status", "--profile", profile)
    for _ in range(20):  # the autopilot's first position takes a moment
        if "nothing limits" in ended.stdout:
            break
        ended = run(folder, "status", "--profile", profile)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert all(name in ended.stdout for name in load("demo").system.services)
    assert "phase idle" in ended.stdout


def test_echo_prints_messages_as_json(system):
    folder, profile, _ = system
    ended = run(folder, "echo", "handle/state", "-n", "3", "--profile", profile)
    lines = [json.loads(line) for line in ended.stdout.splitlines()]
    assert [m["seq"] for m in lines] == list(range(lines[0]["seq"], lines[0]["seq"] + 3))


def test_hz_counts(system):
    folder, profile, _ = system
    ended = run(folder, "hz", "handle/state", "--profile", profile)
    assert ended.returncode == 0
    assert float(found(r"handle/state\s+\S\s+([\d.]+)", ended.stdout)) > 1.0


def test_an_unknown_topic_is_said(system):
    folder, profile, _ = system
    ended = run(folder, "echo", "no/topic", "--profile", profile)
    assert ended.returncode == 2
    assert "no/topic" in ended.stderr


def test_a_note_is_written_into_the_recording(system):
    folder, profile, _ = system
    assert run(folder, "note", "the cable lies well", "--profile", profile).returncode == 0
    ended = run(folder, "note", "nobody listens")  # to the demo of the default name, which does not run here
    assert ended.returncode == 1
    assert "no recorder runs" in ended.stderr


def test_a_second_system_of_the_name_is_refused(system):
    folder, profile, _ = system
    ended = run(folder, "up", profile)
    assert ended.returncode == 1
    assert "already running" in ended.stderr


def test_ctrl_c_stops_everything_and_the_recording_is_whole(system):
    folder, _, process = system
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=30.0)
    assert process.returncode == 0
    (session,) = [f for f in (folder / "sessions").iterdir() if not f.is_symlink() and (f / "session.mcap").exists()]
    recording = read(session / "session.mcap")
    assert recording.damage == ""
    assert recording.verdict.closed
    assert recording.verdict.lost == 0
    assert [note.text for note in recording.messages(NOTE)] == ["the cable lies well"]
    assert inspect(recording).complete


def test_no_autopilot_is_said_by_name_and_everything_stops(tmp_path):
    profile = write_profile(tmp_path, **{"timeout_s = 10.0": "timeout_s = 1.0"})
    text = profile.read_text()
    profile.write_text(re.sub(r'companion = "[^"]*"', f'companion = "127.0.0.1:{free_port()}"', text))
    ended = run(tmp_path, "up", str(profile))
    assert ended.returncode == 1
    assert "px4_bridge" in ended.stderr
    assert "no autopilot" in ended.stderr


def test_a_port_in_use_is_said(tmp_path):
    profile = write_profile(tmp_path)
    port = int(found(r'companion = "127.0.0.1:(\d+)"', profile.read_text()))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", port))
        ended = run(tmp_path, "up", str(profile))
    (line,) = ended.stderr.splitlines()
    assert ended.returncode == 2
    assert line.startswith(
        f"{profile}: px4_bridge.link.url = udpin://127.0.0.1:{port}: port {port}: address already in use"
    )
    assert not (tmp_path / "sessions").exists()


def test_bad_configuration_starts_nothing(tmp_path):
    profile = write_profile(tmp_path, **{"f_z_N = 1.0": "f_z_N = 60.0"})
    began = time.monotonic()
    ended = run(tmp_path, "demo", "--no-live", "--profile", str(profile))
    assert ended.returncode == 2
    (line,) = ended.stderr.splitlines()
    assert str(profile) in line
    assert "f_z_N = 60.0" in line
    assert "49.03" in line
    assert not (tmp_path / "sessions").exists(), f"{time.monotonic() - began:.1f} s"
