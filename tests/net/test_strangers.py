"""No stranger on the bus: what each sees, what arrives of what it does, and what the operator is told.

Where "nothing happens" is what is asked, a member of the bus does the same right after and is heard: the ear was open.
"""

import itertools
import json
import os
import re
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from schemas.topics import GUIDANCE, TOPICS
from services.gateway import certs
from tests.net.stranger import PREFIX
from tests.net.two_hosts import GROUND_IP, NAMES, TwoHosts, lines, read_until, stop

ALL = [f"{PREFIX}{topic.key}" for topic in TOPICS]
COMMAND = json.dumps(
    {
        "seq": 10**6, "stamp_ns": 1, "s": 0.5, "path_length_m": 4.0, "scale": 1.0, "path_error_m": 0.0,
        **{key: {"x": 1.0, "y": 1.0, "z": 1.0} for key in ("p_H_d_m", "p_R_d_m", "f_d_N", "u_A_N")},
    }
)  # fmt: skip
SLANDER = (
    "x\n\x1b[2m2026-11-29T01:30:58.689343Z\x1b[0m \x1b[35mTRACE\x1b[0m rx-0 ThreadId(14) "
    "\x1b[2mzenoh::net::routing::interceptor::access_control\x1b[0m\x1b[2m:\x1b[0m "
    f"b1 on CertCommonName(drone:drone) is unauthorized to Put (ingress) on {PREFIX}safety/state"
)
"""A key that looks like a line of the gateway's log."""

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
    _, out, _ = hosts.run("ground", sys.executable, "-P", "-m", "services.console.cli", "status", "--profile", profile)
    rows = [line.split("│") for line in out.splitlines() if line.startswith("│")]
    first = next(n for n, row in enumerate(rows) if "ground_gateway" in row[1])
    more = itertools.takewhile(lambda row: not row[1].strip(), rows[first + 1 :])
    return " ".join(row[-2].strip() for row in (rows[first], *more))


def denied(hosts: TwoHosts) -> dict[str, int]:
    """What `clew link` on the ground says that the access rules refused."""
    words = ("link", "--profile", str(hosts.folder / "ground.toml"), "--json")
    _, out, _ = hosts.run("ground", sys.executable, "-P", "-m", "services.console.cli", *words)
    return {deed: count for deed, count in json.loads(out)["refused"].items() if " by " in deed}


def count(status: str) -> int:
    """How many sessions the operator is told were refused."""
    found = re.search(r"(\d+) sessions refused", status)
    return int(found[1]) if found else 0


def foreign(tmp_path: Path) -> Path:
    """Certificates of the same names from another authority."""
    certs.init(tmp_path / "foreign")
    certs.issue(tmp_path / "foreign", "drone", "drone")
    return tmp_path / "foreign"


def expired(hosts: TwoHosts, tmp_path: Path) -> Path:
    """One of the right authority whose time is over."""
    folder = tmp_path / "expired"
    folder.mkdir()
    for name in ("ca.key", "ca.pem"):
        (folder / name).write_bytes((hosts.folder / "certs" / name).read_bytes())
    certs.issue(folder, "drone", "drone", days=-1)
    return folder


def uninvited(hosts: TwoHosts, tmp_path: Path) -> dict[str, dict[str, Any]]:
    """Sessions without a valid certificate, and one that does not even speak the language."""
    folder = hosts.folder / "certs"
    late = expired(hosts, tmp_path)
    return {
        "no certificate": tls(folder, ""),
        "no certificate, tls": tls(folder, "", link=TLS),
        "foreign authority": tls(foreign(tmp_path), "drone", folder / "ca.pem"),
        "expired": tls(late, "drone"),
        "expired, tls": tls(late, "drone", link=TLS),
        "plain tcp": {"connect/endpoints": [f"tcp/{GROUND_IP}:7450"]},
        "udp": {"connect/endpoints": [f"udp/{GROUND_IP}:7447"]},
    }


def test_who_has_no_valid_certificate_does_not_get_a_session(hosts: TwoHosts, tmp_path):
    ear, gate = Ear(hosts, GUIDANCE.key), Ear(hosts, "+health/ground_gateway", host="ground", name="watcher")
    tried: dict[str, tuple[float, float]] = {}
    time.sleep(1.5)  # a heartbeat from before them
    for who, settings in uninvited(hosts, tmp_path).items():
        began_s = time.monotonic()
        seen = stranger(hosts, settings, subscribe=ALL, put=[[PREFIX + GUIDANCE.key, COMMAND]])
        assert not seen["open"] or seen["routers"] == 0, who
        assert not seen.get("heard"), who
        time.sleep(1.0)  # two heartbeats
        tried[who] = began_s, time.monotonic()
    speak(hosts)
    taken, refused = ear.heard()
    assert len(taken) > 50
    assert refused == {}
    said = [(beat["t_s"], beat["said"]["status"]) for beat in gate.heard()[0]]
    assert "drone:drone" in said[-1][1]
    for who, (began_s, ended_s) in tried.items():
        before, after = (max((t, text) for t, text in said if t < limit_s)[1] for limit_s in (began_s, ended_s))
        is_told = count(after) > count(before)
        assert is_told is (who != "udp"), f"{who}: {after}: what is no QUIC is dropped without a word"
        assert "expired" not in who or "expired" in after, after


@pytest.mark.parametrize("name", ["screen", "console"])
def test_a_role_may_do_what_the_table_says_and_no_more(hosts: TwoHosts, name):
    ear = Ear(hosts, GUIDANCE.key, "safety/state")
    keys = (GUIDANCE.key, "safety/state", "**", "guidance/*", "setpoint/sent", SLANDER)
    puts = [[PREFIX + key, COMMAND] for key in keys]
    seen = stranger(
        hosts,
        tls(hosts.folder / "certs", name),
        subscribe=[*ALL, f"{PREFIX}**"],
        put=puts,
        delete=[PREFIX + GUIDANCE.key],
        token=[f"{PREFIX}@alive/px4_bridge"],
        query=[f"{PREFIX}@clock/ground"],
        seconds=2.5,
    )
    assert seen["open"], seen
    assert seen["heard"].get(f"{PREFIX}radio/clock", 0) > 0, "it may watch"
    assert seen["answers"] == [f"{PREFIX}@clock/ground"], "and ask the time"
    counted, who = denied(hosts), f"{NAMES[name]}:{name}"
    for deed in (
        "put guidance/command",
        "put safety/state",
        "put setpoint/sent",
        "put another key",
        "delete guidance/command",
    ):
        assert counted[f"{deed} by {who}"] > 10, counted
    assert counted[f"token @alive/px4_bridge by {who}"] > 0
    assert not [deed for deed in counted if deed.endswith(("drone:drone", "ground:ground", "somebody"))], counted
    assert f"by {who}" in told(hosts)
    speak(hosts)
    taken, refused = ear.heard()
    assert {entry["key"] for entry in taken} == {GUIDANCE.key}
    assert max(entry["seq"] for entry in taken) < 10**6
    assert refused == {}


def test_the_operator_commands_and_the_viewer_does_not(hosts: TwoHosts):
    request = json.dumps({"seq": 1, "stamp_ns": 1, "action": "start", "operator": "eve", "request_id": 1})
    for name, arrives in (("screen", False), ("console", True)):
        ear = Ear(hosts, "@cmd/request", name="safety_supervisor")
        assert stranger(hosts, tls(hosts.folder / "certs", name), put=[[f"{PREFIX}@cmd/request", request]])["open"]
        taken, refused = ear.heard()
        assert taken == [], "its stamp is from long ago"
        assert bool(refused.get("@cmd/request")) is arrives
        assert (f"put @cmd/request by {NAMES[name]}:{name}" in denied(hosts)) is not arrives


def test_a_name_that_is_not_in_the_profile_is_shut_out_and_named(hosts: TwoHosts):
    file = hosts.folder / "old.json"
    settings = tls(hosts.folder / "certs", "old")
    others = [key for key in ALL if key != PREFIX + GUIDANCE.key]  # its own word it hears at home
    orders = {"settings": settings, "seconds": 12.0, "subscribe": others, "put": [[PREFIX + GUIDANCE.key, COMMAND]]}
    file.write_text(json.dumps(orders))
    ear = Ear(hosts, GUIDANCE.key)
    process = hosts.start("drone", sys.executable, "-m", "tests.net.stranger", str(file))
    assert any("SHUT OUT, not in radio.names: viewer:old" in told(hosts) for _ in range(5))
    out, _ = process.communicate(timeout=30.0)
    hosts.processes.remove(process)
    assert lines(out)[-1]["heard"] == {}
    speak(hosts)
    taken, refused = ear.heard()
    assert max(entry["seq"] for entry in taken) < 10**6
    assert refused == {}


def test_a_spoofed_token_is_not_seen(hosts: TwoHosts):
    file = hosts.folder / "token.json"
    token = [f"{PREFIX}@alive/px4_bridge"]
    file.write_text(json.dumps({"settings": tls(hosts.folder / "certs", "screen"), "seconds": 8.0, "token": token}))
    spoof = hosts.start("drone", sys.executable, "-m", "tests.net.stranger", str(file))
    time.sleep(1.5)
    _, out, _ = hosts.run(
        "ground", sys.executable, "-m", "tests.net.ends", "who", str(hosts.folder / "ground.toml"), "me"
    )
    alive = lines(out)[-1]["alive"]
    stop(spoof)
    hosts.processes.remove(spoof)
    assert "px4_bridge" not in alive
    assert {"drone_gateway", "ground_gateway"} <= set(alive), "a true token is"


def test_monsters_and_thousands_of_keys_do_not_disturb_the_flow(hosts: TwoHosts):
    ear = Ear(hosts, GUIDANCE.key)
    profile = str(hosts.folder / "ground.toml")
    voice = hosts.end("ground", "voice", profile, "guiding_controller", GUIDANCE.key, "100", "20")
    read_until(voice, "speaking")
    time.sleep(2.0)
    settings = tls(hosts.folder / "certs", "console")
    stranger(hosts, settings, put=[[f"{PREFIX}@cmd/request", 50_000_000]], seconds=1.0)
    stranger(hosts, settings, base=f"{PREFIX}handle", many=20_000, seconds=1.0)
    voice.communicate(timeout=60.0)
    taken, refused = ear.heard()
    seqs = [entry["seq"] for entry in taken]
    gaps = [b["t_s"] - a["t_s"] for a, b in itertools.pairwise(taken)]
    assert len(seqs) > 1500
    assert len(seqs) / (seqs[-1] - seqs[0] + 1) > 0.99
    assert max(gaps) < 1.0
    assert refused == {}
    assert "drone:drone" in told(hosts)
    assert denied(hosts)["put another key by operator:console"] > 100


def test_a_replay_on_the_ground_itself_is_refused_and_counted(hosts: TwoHosts):
    """Whoever is the same user on the ground station may put anything: then age, order and future are what protects."""
    ear = Ear(hosts, f"+{GUIDANCE.key}")
    speak(hosts, 1.5)
    taken, refused = ear.heard()
    assert refused == {}
    said = [entry["said"] for entry in taken][-20:]
    path = hosts.run_dir("ground") / "t" / "ground_gateway.sock"
    local = {"mode": "peer", "connect/endpoints": [f"unixsock-stream/{path}"]}
    now_ns = time.monotonic_ns()
    future = {**said[-1], "seq": 10**6, "stamp_ns": now_ns + 10**12}
    ear = Ear(hosts, GUIDANCE.key)
    puts = [[PREFIX + GUIDANCE.key, json.dumps(each)] for each in (*said, future)]
    assert stranger(hosts, local, host="ground", put=puts, seconds=2.0)["open"]
    speak(hosts)
    taken, refused = ear.heard()
    assert refused[GUIDANCE.key] >= 10
    assert max(entry["seq"] for entry in taken) <= 101, "only the living voice is heard"


def connect(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(str(path))


def test_another_user_does_not_reach_a_socket(hosts: TwoHosts):
    path = hosts.run_dir("ground") / "t" / "ground_gateway.sock"
    for parent in hosts.folder.parents:  # so that it is the folder of the sockets that refuses
        if parent != Path("/") and parent != Path("/tmp"):
            parent.chmod(0o755)
    hosts.folder.chmod(0o755)
    connect(path)  # as its owner, it can be reached
    pid = os.fork()
    if pid == 0:  # another interpreter may be where that user cannot start it
        os.setgid(65534)
        os.setuid(65534)
        try:
            connect(path)
        except PermissionError:
            os._exit(0)
        os._exit(1)
    assert os.waitpid(pid, 0)[1] == 0
