"""No stranger on the bus: what each sees, what arrives of what it does, and what the operator is told.

Where "nothing happens" is what is asked, a member of the bus does the same right after and is heard: the ear was open.
"""

import json
import os
import socket
import sys
import time
from pathlib import Path
from typing import Any

from schemas.topics import GUIDANCE
from services.gateway import certs
from tests.net.stranger import PREFIX
from tests.net.two_hosts import GROUND_IP, TwoHosts, lines
from tests.net.visits import ALL, COMMAND, TLS, Ear, count, speak, stranger, tls, told


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
