"""PX4 as a process: started in a folder of its own, joined by its simulator's port, stopped with us whatever happens."""

import asyncio
import ctypes
import os
import re
import signal
import socket
import subprocess
from collections.abc import AsyncGenerator, Generator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from pathlib import Path

from services.runtime.plain import PlainError
from services.sections import Vehicle
from services.simulator import px4_sitl, radio_control
from services.simulator.px4_hil import Px4Hil
from services.simulator.px4_sitl import Px4Parameters, Px4Sitl
from services.simulator.radio_control import RadioControl

STOP_s = 0.7
_POLL_s = 0.1
_TAIL_lines = 8
_PR_SET_PDEATHSIG = 1
INSTANCE, AIRFRAME = "simulator.px4_sitl.instance", "simulator.px4_sitl.airframe"
_UNKNOWN_PARAMETER = re.compile(r"Parameter (\w+) not found")


class Px4NotThere(PlainError):
    """PX4 cannot be started, or does not come; the text says what to do."""


def check(p: Px4Sitl) -> None:
    """Program and port, before anything starts. Raises Px4NotThere."""
    if p.binary:
        _etc(Path(p.binary))
    with _listening(p.port):
        pass


@asynccontextmanager
async def connected(p: Px4Sitl, vehicle: Vehicle, laboratory: Px4Parameters, folder: str) -> AsyncGenerator[Px4Hil]:
    """PX4 connected to our physics: started where `p.binary` names one, else waited for.

    Its files go to `<folder>/px4`, its words to `<folder>/logs/px4.log`. Raises Px4NotThere.
    """
    pilot = RadioControl() if p.radio_control else None
    held_by_pilot = radio_control.PARAMETERS if pilot else {}
    parameters = px4_sitl.of_vehicle(vehicle.quadrotor, vehicle.cascade) | laboratory | held_by_pilot | p.parameters
    async with AsyncExitStack() as held:
        listener = held.enter_context(_listening(p.port))
        process = held.enter_context(started(p, parameters, Path(folder)))
        connection = held.enter_context(await _first(listener, p, process, Path(folder)))
        if process is not None:
            _check_parameters(Path(folder), parameters)
        yield Px4Hil(connection, pilot)


@contextmanager
def started(p: Px4Sitl, parameters: Px4Parameters, folder: Path) -> Generator[subprocess.Popen[bytes] | None]:
    """The program with its parameters; None where somebody else starts it. It ends with the thread that entered."""
    if not p.binary:
        yield None
        return
    work, log = folder / "px4", folder / "logs" / "px4.log"
    for place in (work, log.parent):
        place.mkdir(parents=True, exist_ok=True)
    command = [p.binary, "-d", "-i", str(p.instance), "-w", str(work), str(_etc(Path(p.binary)))]
    env = {**os.environ, **px4_sitl.environment(parameters, p.airframe)}
    with log.open("wb") as out:
        try:
            process = subprocess.Popen(
                command, env=env, stdin=subprocess.DEVNULL, stdout=out, stderr=out, preexec_fn=_ends_with_us()
            )
        except OSError as error:
            raise Px4NotThere(f"cannot start {p.binary}: {error.strerror}") from None
    try:
        yield process
    finally:
        _stop(process)


def _etc(binary: Path) -> Path:
    """PX4's start scripts, which are installed beside its bin folder. Raises Px4NotThere."""
    etc = binary.resolve().parent.parent / "etc"
    if not (etc / "init.d-posix" / "rcS").is_file():
        raise Px4NotThere(f"{binary}: no PX4 for simulation: {etc}/init.d-posix/rcS is missing: give a build's bin/px4")
    return etc


def _ends_with_us():  # noqa: ANN202
    """For the child: SIGKILL from the kernel when its parent is gone, for without a simulator PX4 would spin for ever."""
    prctl = ctypes.CDLL(None).prctl  # loaded here: a child of a process with threads must not
    return lambda: prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _stop(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(STOP_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


@contextmanager
def _listening(port: int) -> Generator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind(("127.0.0.1", port))
        except OSError as error:
            why = f"port {port}, where PX4 looks for its simulator: {(error.strerror or str(error)).lower()}"
            raise Px4NotThere(
                f"{why}: stop the demo or simulator that listens there, or take another {INSTANCE}"
            ) from None
        listener.listen(1)
        listener.setblocking(False)
        yield listener


async def _first(
    listener: socket.socket, p: Px4Sitl, process: subprocess.Popen[bytes] | None, folder: Path
) -> socket.socket:
    """The connection, unless PX4 ends or does not come."""
    loop = asyncio.get_running_loop()
    accepting = asyncio.ensure_future(loop.sock_accept(listener))
    try:
        for _ in range(int(p.appears_s / _POLL_s)):
            done, _ = await asyncio.wait([accepting], timeout=_POLL_s)
            if done:
                return accepting.result()[0]
            if process is not None and process.poll() is not None:
                raise Px4NotThere(f"PX4 ended with exit code {process.returncode}{_last_words(folder)}")
    finally:
        accepting.cancel()
    where = f"connected to port {p.port} within {p.appears_s:g} s"
    if p.binary:
        raise Px4NotThere(f"{p.binary} has not {where}: see px4.log; is {AIRFRAME} one that waits for a simulator?")
    raise Px4NotThere(f"no PX4 has {where}: give its program by --px4 or PX4_BIN, or start one")


def _check_parameters(folder: Path, wanted: Px4Parameters) -> None:
    """PX4 goes on without a parameter that it does not know, and only its log says so. Raises Px4NotThere."""
    unknown = sorted(set(_UNKNOWN_PARAMETER.findall("\n".join(_words(folder)))) & set(wanted))
    if unknown:
        raise Px4NotThere(f"PX4 has no parameter {', '.join(unknown)}: is its version the one that the profile is for?")


def _words(folder: Path) -> list[str]:
    return (folder / "logs" / "px4.log").read_text(errors="replace").splitlines()


def _last_words(folder: Path) -> str:
    lines = _words(folder)[-_TAIL_lines:]
    return "".join(f"\n  px4: {line}" for line in lines)
