"""Two hosts on one machine: two network namespaces, a bad radio between them, and what runs in each. Needs root.

The drone is 10.78.0.1 and the ground 10.78.0.2 on the radio. A clean pair of interfaces, 10.79.0.1 and .2, carries the
simulated vehicle's MAVLink, which in reality is a cable on the drone. The drone's monotonic clock may be shifted by a
time namespace, so that the hosts' clocks differ as those of two machines do.
"""

import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from services.gateway import certs
from services.gateway.radio import Role
from tests.net import bad_radio
from tests.processes.host import first

DRONE_IP, GROUND_IP = bad_radio.ADDRESS["a"], bad_radio.ADDRESS["b"]
NAMES: dict[str, Role] = {"drone": "drone", "ground": "ground", "console": "operator", "screen": "viewer"}
ROOT = Path(__file__).parents[2]
CLEW = (sys.executable, "-P", "-m", "services.console.cli")


@cache
def can() -> bool:
    """Whether this process may make namespaces and TUN devices: tried, because a container's root often may not."""
    space = f"clew{os.getpid()}try"
    try:
        _ip("netns", "add", space)
    except (OSError, subprocess.CalledProcessError):
        return False
    try:
        os.close(bad_radio.tun(space, DRONE_IP, GROUND_IP))
        subprocess.run(["unshare", "--time", "--monotonic", "1", "true"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return False
    finally:
        _ip("netns", "del", space)
    return True


def make_certificates(into: Path, names: dict[str, Role] = NAMES) -> None:
    """An authority, and a certificate for each name."""
    certs.init(into)
    for name, role in names.items():
        certs.issue(into, name, role, [GROUND_IP])


def write_profile(file: Path, host: str, radio: str = "", extra: str = "", names: dict[str, Role] = NAMES) -> Path:
    """The two-host profile for these addresses; `radio` is more TOML in that section, `extra` at the end."""
    known = ", ".join(f'"{role}:{name}"' for name, role in names.items())
    file.write_text(
        f'base = "two_hosts"\n[system]\nname = "t"\nhost = "{host}"\n'
        f'[radio]\naddress = "{GROUND_IP}"\nconsole = "console"\nnames = [{known}]\n{radio}'
        f'[simulator]\ncompanion = "10.79.0.1:14540"\n{extra}'
    )
    return file


@dataclass
class TwoHosts:
    """The namespaces while they exist, and every process in them; leaving ends and removes all."""

    folder: Path
    drone_ahead_s: int = 0
    processes: list[subprocess.Popen[str]] = field(default_factory=list[subprocess.Popen[str]])
    _started: int = 0

    def __enter__(self) -> Self:
        self.space = {host: f"clew{os.getpid()}{host[0]}" for host in ("drone", "ground")}
        for space in self.space.values():
            _ip("netns", "add", space)
            _ip("-n", space, "link", "set", "lo", "up")
        drone, ground = self.space.values()
        _ip("link", "add", "cable", "netns", drone, "type", "veth", "peer", "name", "cable", "netns", ground)
        for space, address in ((drone, "10.79.0.1/24"), (ground, "10.79.0.2/24")):
            _ip("-n", space, "addr", "add", address, "dev", "cable")
            _ip("-n", space, "link", "set", "cable", "up")
        self.radio = subprocess.Popen(
            [sys.executable, str(Path(bad_radio.__file__)), drone, ground],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.radio.stdout
        assert self.radio.stdout.readline() == "ready\n"
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in reversed(self.processes):
            stop(process)
        assert self.radio.stdin
        assert self.radio.stdout
        self.radio.stdin.close()
        self.radio.wait(5.0)
        self.radio.stdout.close()
        for space in self.space.values():
            _ip("netns", "del", space)

    def shape(self, **how: float | bool) -> dict[str, dict[str, list[int]]]:
        """Change the radio; returns what it was given so far, up (drone to ground) and down: by port, packets and bytes."""
        assert self.radio.stdin
        assert self.radio.stdout
        self.radio.stdin.write(json.dumps(how) + "\n")
        self.radio.stdin.flush()
        return json.loads(self.radio.stdout.readline())

    def start(self, host: str, *command: str, env: dict[str, str] | None = None, **how: Any) -> subprocess.Popen[str]:
        """A process on one of the hosts."""
        prefix = ["ip", "netns", "exec", self.space[host]]
        if host == "drone" and self.drone_ahead_s:
            prefix += ["unshare", "--time", "--monotonic", str(self.drone_ahead_s), "--fork", "--kill-child", "--"]
        where = {"CLEW_RUN_DIR": str(self.run_dir(host)), "CLEW_CERTS_DIR": str(self.folder / "certs")}
        with self._log(host).open("w") as log:
            process = subprocess.Popen(
                [*prefix, *command],
                cwd=ROOT,
                env=os.environ | where | (env or {}),
                text=True,
                stdout=subprocess.PIPE,
                stderr=log,
                start_new_session=True,
                **how,
            )
        self.processes.append(process)
        return process

    def _log(self, host: str) -> Path:
        self._started += 1
        return self.folder / f"{host}-{self._started}.log"

    def run(self, host: str, *command: str, timeout_s: float = 30.0) -> tuple[int, str, str]:
        """A command to its end: exit code, what it printed, what it complained."""
        process = self.start(host, *command)
        log = self.folder / f"{host}-{self._started}.log"
        out, _ = process.communicate(timeout=timeout_s)
        self.processes.remove(process)
        return process.returncode, out, log.read_text()

    def clew(self, host: str, *arguments: str) -> subprocess.Popen[str]:
        """`clew ...` on one of the hosts."""
        return self.start(host, *CLEW, *arguments)

    def service(self, host: str, name: str, profile: str) -> None:
        """`clew run` on one of the hosts, before all that only listens: in reality no host takes processors from the other."""
        self.start(host, *first(loop=True), *CLEW, "run", name, "--profile", profile)

    def gateway(self, host: str) -> subprocess.Popen[str]:
        """That host's gateway, by its profile in the folder."""
        return self.clew(host, "run", "gateway", "--profile", str(self.folder / f"{host}.toml"))

    def gateway_pid(self, host: str) -> int:
        """Of the one that runs."""
        return int(Path(self.run_dir(host), "t", f"{host}_gateway.pid").read_text())

    @contextmanager
    def without_gateway(self, host: str) -> Generator[None]:
        """It is killed, and another begins at the end."""
        os.kill(self.gateway_pid(host), signal.SIGKILL)
        try:
            yield
        finally:
            self.gateway(host)

    def end(self, host: str, *arguments: str, **how: Any) -> subprocess.Popen[str]:
        """One end of a conversation, see ends.py."""
        return self.python(host, "tests.net.ends", *arguments, **how)

    def python(self, host: str, module: str, *arguments: str, **how: Any) -> subprocess.Popen[str]:
        """A module of this checkout."""
        return self.start(host, sys.executable, "-P", "-m", module, *arguments, **how)

    def run_dir(self, host: str) -> Path:
        """Where that host's sockets are."""
        return self.folder / host


def stop(process: subprocess.Popen[str], number: int = signal.SIGINT) -> None:
    """Ask, then make sure."""
    if process.poll() is None:
        os.killpg(process.pid, number)
        try:
            process.wait(4.0)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait(5.0)
    for pipe in (process.stdin, process.stdout):
        if pipe:
            pipe.close()


def read_until(process: subprocess.Popen[str], word: str, timeout_s: float = 20.0) -> str:
    """The first line of its output that contains `word`."""
    assert process.stdout
    deadline, text, out = time.monotonic() + timeout_s, "", process.stdout.fileno()
    while (left_s := deadline - time.monotonic()) > 0.0:
        if select.select([out], [], [], left_s)[0]:
            data = os.read(out, 65_536)
            text += data.decode()
            found = [line for line in text.splitlines() if word in line]
            if found:
                return found[0]
            if not data:
                break
    raise AssertionError(f"no {word!r} from {process.args}: {text[-500:]!r}")


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


def lines(text: str) -> Sequence[dict[str, Any]]:
    """JSON, one object a line."""
    return [json.loads(line) for line in text.splitlines() if line.startswith("{")]
