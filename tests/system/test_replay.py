"""A replay is heard by who asks for it and by nobody else, keeps its speed, and gives way to a vehicle."""

import asyncio
import json
import os
import subprocess
import sys
import time

import pytest

from schemas.topics import HANDLE_STATE, SAFETY_STATE
from services.console import replay
from services.recorder.reading import read
from services.runtime.bus_config import BusConfig, claim
from services.runtime.zenoh_bus import open_bus
from tests.services import synthetic
from tests.services.synthetic_world import Scenario
from tests.system.demo_profile import clew, run, write_profile

SHORT = Scenario(guiding_s=2.0)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return synthetic.write(tmp_path_factory.mktemp("replay") / "session.mcap", SHORT)


def test_everything_is_said_in_order_at_its_time(file, tmp_path, monkeypatch):
    monkeypatch.setenv("CLEW_RUN_DIR", str(tmp_path))
    session, heard = read(file), []
    expected = session.logs[HANDLE_STATE.key].payloads

    async def main():
        config = replay.replay_bus_config()
        with open_bus(config, replay.PLAYER) as player, open_bus(config, "ear") as ear:
            ear.subscribe(HANDLE_STATE.key, lambda key, payload: heard.append(payload))
            began = time.monotonic()
            await replay.play(session, player, 10.0)
            return time.monotonic() - began

    took_s = asyncio.run(main())
    assert heard[-len(expected) + 10 :] == expected[-len(heard) :][-len(expected) + 10 :]
    assert len(heard) > len(expected) - 10  # the first may come before the link is up
    assert session.duration_s / 10.0 < took_s


def test_who_listens_to_the_living_system_hears_nothing(file, tmp_path, monkeypatch):
    monkeypatch.setenv("CLEW_RUN_DIR", str(tmp_path))
    heard = []

    async def main():
        live = BusConfig(system="demo", run_dir=str(tmp_path), services=("tracker", replay.PLAYER))
        with open_bus(replay.replay_bus_config(), replay.PLAYER) as player, open_bus(live, "ear") as ear:
            ear.subscribe(SAFETY_STATE.key, lambda key, payload: heard.append(payload))
            await replay.play(read(file), player, 1000.0)

    asyncio.run(main())
    assert heard == []


def test_a_person_looks_into_it_by_the_command_line(file, tmp_path):
    profile = write_profile(tmp_path)
    process = clew(tmp_path, "replay", str(file), "--speed", "0.5")
    try:
        assert process.stdout
        assert "replaying" in process.stdout.readline()
        ended = run(tmp_path, "echo", "handle/state", "-n", "2", "--replay", "--profile", str(profile))
        assert [json.loads(line)["lag_s"] for line in ended.stdout.splitlines()] == pytest.approx([0.01, 0.01])
    finally:
        process.terminate()
        process.communicate()


def test_it_is_refused_beside_a_vehicle_and_gives_way_to_one(file, tmp_path, monkeypatch):
    monkeypatch.setenv("CLEW_RUN_DIR", str(tmp_path))
    config = BusConfig(system="lab", run_dir=str(tmp_path), services=(replay.BRIDGE,))
    with claim(config, replay.BRIDGE):
        refused = played(file, tmp_path)
        assert refused.returncode == 1
        assert "system lab is connected to a vehicle" in refused.stderr

    async def main():
        with open_bus(replay.replay_bus_config(), replay.PLAYER) as player:
            playing = asyncio.create_task(replay.play(read(file), player, 1.0))
            await asyncio.sleep(0.5)
            with claim(config, replay.BRIDGE):
                await asyncio.wait_for(playing, 3.0)

    with pytest.raises(replay.VehicleConnected):
        asyncio.run(main())


def played(file, run_dir):
    """The command, in the run folder of the test."""
    command = [sys.executable, "-P", "-m", "services.console.cli", "replay", str(file), "--speed", "100"]
    env = os.environ | {"CLEW_RUN_DIR": str(run_dir)}
    return subprocess.run(command, env=env, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize(
    ("arguments", "why"), [(("--speed", "0"), "must be above 0"), (("--start", "999"), "the session lasts")]
)
def test_bad_input_is_one_line(file, tmp_path, arguments, why):
    ended = run(tmp_path, "replay", str(file), *arguments)
    assert ended.returncode == 2
    assert why in ended.stderr
    assert ended.stderr.count("\n") == 1
