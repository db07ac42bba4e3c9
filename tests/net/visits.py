"""What somebody else on the bus is let try, who listens meanwhile, and what the operator is told of it."""

import itertools
import json
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from schemas.topics import GUIDANCE, TOPICS
from tests.net.stranger import PREFIX
from tests.net.two_hosts import CLEW, GROUND_IP, TwoHosts, lines, read_until

ALL = [f"{PREFIX}{topic.key}" for topic in TOPICS]
COMMAND = json.dumps(
    {
        "seq": 10**6, "stamp_ns": 1, "s": 0.5, "path_length_m": 4.0, "scale": 1.0, "path_error_m": 0.0,
        **{key: {"x": 1.0, "y": 1.0, "z": 1.0} for key in ("p_H_d_m", "p_R_d_m", "f_d_N", "u_A_N")},
    }
)  # fmt: skip
QUIC, TLS = f"quic/{GROUND_IP}:7447?mixed_rel=1;prio=1-1", f"tls/{GROUND_IP}:7450?prio=6-7"


def tls(folder: Path, name: str, ca: Path | None = None, link: str = QUIC, **more: Any) -> dict[str, Any]:
    """A session over the radio with a certificate, or without where the name is empty."""
    own = {
        "transport/link/tls/enable_mtls": True,
        "transport/link/tls/connect_certificate": str(folder / f"{name}.pem"),
        "transport/link/tls/connect_private_key": str(folder / f"{name}.key"),
    }
    return {
        "connect/endpoints": [link],
        "transport/link/tls/root_ca_certificate": str(ca or folder / "ca.pem"),
        **(own if name else {}),
        **more,
    }


def stranger(hosts: TwoHosts, settings: dict[str, Any], *, host: str = "drone", **orders: Any) -> dict[str, Any]:
    """Let it try, on the drone's side of the radio, and hear what it saw."""
    file = hosts.folder / f"orders-{time.monotonic_ns()}.json"
    file.write_text(json.dumps({"settings": settings, "seconds": 1.5, **orders}))
    code, out, complaint = hosts.run(host, sys.executable, "-m", "tests.net.stranger", str(file), timeout_s=60.0)
    assert code == 0, complaint
    return lines(out)[-1]


class Ear:
    """The bridge's place on the drone, while a stranger tries."""

    def __init__(self, hosts: TwoHosts, *keys: str, host: str = "drone", name: str = "px4_bridge"):
        profile = str(hosts.folder / f"{host}.toml")
        self._process = hosts.end(host, "ear", profile, name, "0", *keys, stdin=subprocess.PIPE)
        self._hosts = hosts
        read_until(self._process, "listening")

    def heard(self) -> tuple[list[dict[str, Any]], dict[str, int]]:
        """What arrived and was taken until now; what was refused."""
        time.sleep(0.5)  # what is under way still counts
        out, _ = self._process.communicate(timeout=60.0)
        self._hosts.processes.remove(self._process)
        *taken, last = lines(out)
        return taken, last["rejected"]


def speak(hosts: TwoHosts, seconds: float = 1.0) -> None:
    """The guiding controller on the ground says its word."""
    profile = str(hosts.folder / "ground.toml")
    voice = hosts.end("ground", "voice", profile, "guiding_controller", GUIDANCE.key, "100", str(seconds))
    voice.communicate(timeout=30.0)
    hosts.processes.remove(voice)


def told(hosts: TwoHosts) -> str:
    """The ground gateway's word in `clew status`, over as many lines as it has there."""
    profile = str(hosts.folder / "ground.toml")
    _, out, _ = hosts.run("ground", *CLEW, "status", "--profile", profile)
    rows = [line.split("│") for line in out.splitlines() if line.startswith("│")]
    first = next(n for n, row in enumerate(rows) if "ground_gateway" in row[1])
    more = itertools.takewhile(lambda row: not row[1].strip(), rows[first + 1 :])
    return " ".join(row[-2].strip() for row in (rows[first], *more))


def denied(hosts: TwoHosts) -> dict[str, int]:
    """What `clew link` on the ground says that the access rules refused."""
    words = ("link", "--profile", str(hosts.folder / "ground.toml"), "--json")
    _, out, _ = hosts.run("ground", *CLEW, *words)
    return {deed: count for deed, count in json.loads(out)["refused"].items() if " by " in deed}


def count(status: str) -> int:
    """How many sessions the operator is told were refused."""
    found = re.search(r"(\d+) sessions refused", status)
    return int(found[1]) if found else 0
