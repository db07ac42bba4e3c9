"""Real processes with real Zenoh: they end when they must, always, and nothing is left behind."""

import asyncio
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from schemas.topics import HEALTH, SERVICES
from services.runtime.bus_config import BusConfig
from services.runtime.clock import MonotonicClock
from services.runtime.launcher import ServiceDied, launch
from services.runtime.node import Node
from services.runtime.zenoh_bus import open_bus

PATIENCE_s = 30.0

SERVICE = """
import asyncio, os, sys, time
from schemas.topics import BY_KEY, SERVICES
from services.runtime.bus_config import BusConfig
from services.runtime.plain import PlainError
from services.runtime.process import serve

async def fail():
    raise KeyError("on purpose")

async def miss():
    raise PlainError("nobody is there: call somebody")

async def run(node, how):
    readers = [node.stream(topic) for topic in BY_KEY.values() if node.name in topic.subscribers]
    try:
        async for tick in node.ticks(50.0):
            if tick.n < 5:
                continue
            if how == "crash":
                raise KeyError("on purpose")
            if how == "crash in a task":
                task = asyncio.ensure_future(fail())
                await asyncio.sleep(0)
                task = None
            if how == "crash in a callback":
                asyncio.get_running_loop().call_soon(int, "on purpose")
            if how == "miss":
                async with asyncio.TaskGroup() as loops:
                    loops.create_task(asyncio.sleep(9.0))
                    loops.create_task(miss())
            if how == "finish":
                return
            kept = []
            while how == "leak":
                kept.append(os.urandom(1) * (16 << 20))
            print("running", flush=True)
            while how == "hang":
                pass
    except asyncio.CancelledError:
        print("asked to stop", flush=True)
        while how == "stubborn":
            try:
                await asyncio.sleep(3600)
            except asyncio.CancelledError:
                pass
        raise

name, how, run_dir = sys.argv[1:]
sys.exit(serve(name, run, how, BusConfig(system="test", run_dir=run_dir, services=SERVICES)))
"""

LAUNCHER = """
import asyncio, json, pathlib, signal, sys
from schemas.topics import SERVICES
from services.runtime.bus_config import BusConfig
from services.runtime.launcher import launch

async def main(run_dir, commands):
    config = BusConfig(system="test", run_dir=run_dir, services=SERVICES)
    async with launch(commands, config, pathlib.Path(run_dir, "logs"), timeout_s=60.0) as launched:
        print(*(process.pid for process in launched.processes.values()), flush=True)
        await launched.wait()

signal.signal(signal.SIGINT, signal.default_int_handler)  # as clew does: a script in the background has it ignored
asyncio.run(main(sys.argv[1], json.loads(sys.argv[2])))
"""


@pytest.fixture
def config(tmp_path):
    return BusConfig(system="test", run_dir=str(tmp_path), services=SERVICES)


def command(config, name, how):
    return [sys.executable, "-P", "-c", SERVICE, name, how, config.run_dir]


@pytest.fixture
def start(config):
    """Starts a service; what still runs at the end of the test is killed."""
    started = []

    def start(name, how):
        process = subprocess.Popen(
            command(config, name, how), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def until_running(process):
    assert process.stdout.readline() == "running\n"


def until_gone(pids):
    deadline = time.monotonic() + PATIENCE_s
    while any(is_running(pid) for pid in pids):
        assert time.monotonic() < deadline, f"still there: {pids}"
        time.sleep(0.05)


async def until(condition):
    while not condition():  # noqa: ASYNC110 - nothing to wait on but the condition
        await asyncio.sleep(0.05)


def is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")")[-1].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.parametrize("how", ["crash", "crash in a task", "crash in a callback", "leak"])
def test_an_uncaught_error_ends_the_process_with_one_clear_line(start, how):
    process = start("safety_supervisor", how)
    _, errors = process.communicate(timeout=PATIENCE_s)
    assert process.returncode == 1
    first_words = ("KeyError: 'on purpose'", "ValueError: invalid", "MemoryError")
    said = tuple(f"safety_supervisor failed: {words}" for words in first_words)
    assert any(line.startswith(said) for line in errors.splitlines())
    assert "Traceback" in errors


def test_a_plain_error_of_one_of_several_loops_is_one_line(start):
    process = start("safety_supervisor", "miss")
    (line,) = process.communicate(timeout=PATIENCE_s)[1].splitlines()
    assert line == "safety_supervisor failed: PlainError: nobody is there: call somebody"
    assert process.returncode == 1


def test_a_service_that_finishes_exits_0(start):
    process = start("tracker", "finish")
    assert (process.communicate(timeout=PATIENCE_s), process.returncode) == (("", ""), 0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_asks(start, number):
    process = start("safety_supervisor", "run")
    until_running(process)
    process.send_signal(number)
    output, errors = process.communicate(timeout=PATIENCE_s)
    assert (process.returncode, errors) == (0, "")
    assert output.endswith("asked to stop\n")


@pytest.mark.parametrize("how", ["stubborn", "hang"])
def test_who_does_not_listen_is_ended_by_the_kernel(start, how):
    process = start("tracker", how)
    until_running(process)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=PATIENCE_s)
    assert process.returncode == -signal.SIGALRM


def test_the_second_signal_forces(start):
    process = start("tracker", "stubborn")
    until_running(process)
    process.send_signal(signal.SIGINT)
    while process.stdout.readline() != "asked to stop\n":
        pass
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=PATIENCE_s)
    assert process.returncode == 128 + signal.SIGINT


def test_a_name_is_held_once_and_a_dead_holder_is_no_obstacle(start, config):
    first = start("tracker", "run")
    until_running(first)
    second = start("tracker", "run")
    _, errors = second.communicate(timeout=PATIENCE_s)
    assert second.returncode == 1
    assert errors.count("\n") == 1
    assert f"service tracker of system test is already running (pid {first.pid})" in errors
    first.kill()
    first.wait(timeout=PATIENCE_s)
    assert config.socket("tracker").exists()  # stale
    until_running(start("tracker", "run"))


def test_services_find_each_other_in_any_order_and_say_how_they_are(start, config):
    async def main():
        with open_bus(config, "cli-1") as bus:
            node = Node("operator", bus, MonotonicClock(), observer=True)
            readers = [node.latest(HEALTH[name]) for name in ("tracker", "simulator")]
            start("tracker", "run")
            async with asyncio.timeout(PATIENCE_s):
                await until(lambda: readers[0].message)
                start("simulator", "run")
                await until(lambda: all(reader.fresh for reader in readers))
                assert {"tracker", "simulator"} <= bus.alive()
            return [reader.message for reader in readers]

    for health in asyncio.run(main()):
        assert health is not None
        assert health.pid != os.getpid()
        assert health.service in SERVICES


def test_the_launcher_starts_and_stops_all(config, tmp_path):
    async def main():
        commands = {name: command(config, name, "run") for name in ("tracker", "simulator")}
        async with launch(commands, config, tmp_path / "logs", PATIENCE_s) as launched:
            assert launched.alive >= {"tracker", "simulator"}
            processes = launched.processes
        return [process.returncode for process in processes.values()]

    assert asyncio.run(main()) == [0, 0]
    assert (tmp_path / "logs" / "tracker.log").read_text().endswith("asked to stop\n")


def test_the_launcher_names_who_died_and_stops_the_others(config, tmp_path):
    processes = {}

    async def main():
        commands = {name: command(config, name, "run") for name in ("tracker", "simulator")}
        async with launch(commands, config, tmp_path / "logs", PATIENCE_s) as launched:
            processes.update(launched.processes)
            processes["simulator"].kill()
            await launched.wait()

    with pytest.raises(ServiceDied, match="simulator was killed by SIGKILL"):
        asyncio.run(main())
    assert processes["tracker"].returncode == 0


def test_the_launcher_says_why_a_service_did_not_start(config, tmp_path):
    async def main(commands, timeout_s):
        async with launch(commands, config, tmp_path / "logs", timeout_s):
            pass

    broken = {"tracker": [sys.executable, "-c", "raise SystemExit('no such profile')"]}
    with pytest.raises(ServiceDied, match=r"tracker ended with exit code 1\n  tracker: no such profile"):
        asyncio.run(main(broken, PATIENCE_s))
    mute = {"tracker": [sys.executable, "-c", "input() if False else __import__('time').sleep(60)"]}
    with pytest.raises(TimeoutError, match=r"not alive after 0.5 s: tracker\n  tracker: said nothing"):
        asyncio.run(main(mute, 0.5))


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_nothing_is_left_when_the_launcher_is_killed(config, number):
    commands = {name: command(config, name, "stubborn") for name in ("tracker", "simulator")}
    launcher = subprocess.Popen(
        [sys.executable, "-P", "-c", LAUNCHER, config.run_dir, json.dumps(commands)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert launcher.stdout
    pids = [int(pid) for pid in launcher.stdout.readline().split()]
    assert len(pids) == 2
    launcher.send_signal(number)
    launcher.communicate(timeout=PATIENCE_s)
    until_gone(pids)
