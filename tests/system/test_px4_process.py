"""PX4 as a process that does not do as it should: each a line that says what to do, and nothing is left running."""

import asyncio
import contextlib
import os
import socket
import stat
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from services.config import ConfigError, load
from services.console.start import check_px4
from services.simulator import px4_process
from services.simulator.px4_process import Px4NotThere

CONFIG = load("px4-sitl")


def program(folder: Path, script: str) -> str:
    """What looks like PX4: a program in bin/ beside etc/."""
    (folder / "etc" / "init.d-posix").mkdir(parents=True)
    (folder / "etc" / "init.d-posix" / "rcS").touch()
    binary = folder / "bin" / "px4"
    binary.parent.mkdir()
    binary.write_text(f"#!{sys.executable}\n{script}")
    binary.chmod(binary.stat().st_mode | stat.S_IXUSR)
    return str(binary)


def free_instance() -> int:
    for instance in range(9, 0, -1):
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", 4560 + instance))
            except OSError:
                continue
            return instance
    raise AssertionError("no free port")


def connect(folder: Path, binary: str, appears_s: float = 5.0, meanwhile=None) -> None:
    sitl = CONFIG.simulator.px4_sitl
    assert sitl is not None
    sitl = replace(sitl, binary=binary, instance=free_instance(), appears_s=appears_s)

    async def main():
        async with px4_process.connected(sitl, CONFIG.vehicle, {"EKF2_EV_CTRL": 11}, str(folder)) as hil:
            if meanwhile is not None:
                meanwhile(sitl, hil)

    asyncio.run(main())


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_program_without_its_scripts_is_no_px4(tmp_path):
    with pytest.raises(Px4NotThere, match=r"true: no PX4 for simulation: .*rcS is missing"):
        connect(tmp_path, "/usr/bin/true")


def test_program_and_port_are_looked_at_before_anything_starts(tmp_path):
    sitl = CONFIG.simulator.px4_sitl
    assert sitl is not None

    def refused(**other: Any) -> str:
        simulated = replace(CONFIG.simulator, px4_sitl=replace(sitl, **({"instance": free_instance()} | other)))
        with pytest.raises(ConfigError) as why:
            check_px4(CONFIG.model_copy(update={"simulator": simulated}))
        (line,) = str(why.value).splitlines()
        return line

    assert refused(binary="/usr/bin/true").startswith("/usr/bin/true: no PX4 for simulation: ")
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen(1)
        taken = other.getsockname()[1]
        assert "stop the demo or simulator that listens there" in refused(instance=taken - 4560)


def test_a_service_that_ends_by_it_says_one_line(tmp_path):
    """A user whose PX4 ends has no use for a traceback. The system's name is short, as a socket's path must be."""
    profile = tmp_path / "mine.toml"
    profile.write_text(f'base = "px4-sitl"\n[system]\nname = "p"\n[simulator.px4_sitl]\ninstance = {free_instance()}\n')
    command = [sys.executable, "-P", "-m", "services.console.cli", "run", "simulator", "--profile", str(profile)]
    environment = os.environ | {
        "CLEW_RUN_DIR": str(tmp_path / "run"),
        "PX4_BIN": program(tmp_path, "raise SystemExit(3)"),
    }
    ended = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    (line,) = ended.stderr.splitlines()
    assert line == "simulator failed: Px4NotThere: PX4 ended with exit code 3"


def test_a_px4_that_ends_at_once_is_quoted(tmp_path):
    binary = program(tmp_path, "print('ERROR [init] Unknown model'); raise SystemExit(3)")
    with pytest.raises(Px4NotThere, match=r"ended with exit code 3\n  px4: ERROR \[init\] Unknown model"):
        connect(tmp_path / "session", binary)


def test_a_px4_that_does_not_come_is_named_and_stopped(tmp_path):
    binary = program(
        tmp_path, f"import os, time; open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    )
    with pytest.raises(Px4NotThere, match=r"has not connected to port 456\d within 1 s"):
        connect(tmp_path / "session", binary, appears_s=1.0)
    assert not alive(int((tmp_path / "pid").read_text()))


def test_without_a_program_one_is_waited_for_and_asked_for(tmp_path):
    with pytest.raises(
        Px4NotThere, match=r"no PX4 has connected to .*: give its program by --px4 or PX4_BIN, or start one"
    ):
        connect(tmp_path, "", appears_s=0.3)


def test_a_px4_that_somebody_else_started_is_taken(tmp_path):
    joined, met = threading.Event(), []

    def px4() -> None:
        while not joined.is_set():
            for port in range(4561, 4570):
                with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 0.2):
                    joined.wait(2.0)
                    return

    other = threading.Thread(target=px4)
    other.start()
    try:
        connect(tmp_path, "", meanwhile=lambda _, hil: met.append(hil.starting))
    finally:
        joined.set()
        other.join()
    assert met == [True]
    assert not (tmp_path / "logs").exists()


def test_a_taken_port_is_named(tmp_path):
    sitl = CONFIG.simulator.px4_sitl
    assert sitl is not None
    with socket.socket() as other:
        other.bind(("127.0.0.1", 4560 + free_instance()))
        other.listen(1)
        sitl = replace(sitl, instance=other.getsockname()[1] - 4560)

        async def main():
            async with px4_process.connected(sitl, CONFIG.vehicle, {}, str(tmp_path)):
                pass

        with pytest.raises(
            Px4NotThere, match=rf"port {sitl.port}, where PX4 looks for its simulator: address already in use: stop"
        ):
            asyncio.run(main())


JOINS = """
import os, pathlib, socket, sys, time
work = pathlib.Path(sys.argv[sys.argv.index("-w") + 1])
work.joinpath("told").write_text("\\n".join(f"{k}={v}" for k, v in os.environ.items() if k.startswith("PX4_")))
work.joinpath("pid").write_text(str(os.getpid()))
port = 4560 + int(sys.argv[sys.argv.index("-i") + 1])
while True:
    try:
        joined = socket.create_connection(("127.0.0.1", port)); break
    except OSError:
        time.sleep(0.05)
time.sleep(60)
"""


def test_it_is_started_in_a_folder_of_its_own_with_all_parameters_and_stopped(tmp_path):
    binary = program(tmp_path, JOINS)
    connect(tmp_path / "session", binary)
    work = tmp_path / "session" / "px4"
    told = dict(line.split("=", 1) for line in (work / "told").read_text().splitlines())
    assert told["PX4_SIM_MODEL"] == "none_iris"
    assert told["PX4_PARAM_EKF2_EV_CTRL"] == "11"
    assert float(told["PX4_PARAM_MPC_THR_HOVER"]) == CONFIG.vehicle.cascade.hover_thrust
    assert not alive(int((work / "pid").read_text()))
    assert (tmp_path / "session" / "logs" / "px4.log").is_file()


def test_a_parameter_that_it_does_not_know_is_named(tmp_path):
    """PX4 itself goes on without it. Names that it complains of on its own account are none of ours."""
    words = "for name in ('EKF2_EV_CTRL', 'TRIG_INTERFACE'): print('ERROR [param] Parameter', name, 'not found.', flush=True)"
    binary = program(tmp_path, words + JOINS)
    with pytest.raises(Px4NotThere, match=r"PX4 has no parameter EKF2_EV_CTRL: is its version"):
        connect(tmp_path / "session", binary)


def test_it_ends_with_a_simulator_that_is_killed(tmp_path):
    """Without a simulator PX4 would read a closed connection for ever."""
    binary = program(tmp_path, JOINS)
    script = (
        "import os, signal, sys; from pathlib import Path; from tests.system.test_px4_process import connect\n"
        f"connect(Path({str(tmp_path / 'session')!r}), {binary!r}, meanwhile=lambda *_: os.kill(os.getpid(), signal.SIGKILL))"
    )
    killed = subprocess.run([sys.executable, "-c", script], cwd=Path(__file__).parents[2], check=False)
    assert killed.returncode == -9
    pid = int((tmp_path / "session" / "px4" / "pid").read_text())
    deadline = time.monotonic() + 5.0
    while alive(pid) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not alive(pid)
