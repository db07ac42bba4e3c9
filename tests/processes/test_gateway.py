"""A gateway killed in the walk, on two hosts with a radio between them. Needs root, as tests/net."""

import itertools
import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from schemas.topics import SAFETY_STATE, SETPOINT, TRUTH, VEHICLE_STATE
from tests.net.test_flight import DRONE, GROUND, HURRIED
from tests.net.two_hosts import TwoHosts, can, lines, make_certificates, read_until, write_profile
from tests.processes import host, promises
from tests.processes.window import Window

STALE_S, WALKED_S, WATCHED_S = 0.5, 5.0, 7.0
"""A command lives 0.1 s, the radio may add 0.25 s, and the bridge turns at 125 Hz."""
GAP_S = 0.2
ONBOARD, OUTSIDE = (SETPOINT, SAFETY_STATE, VEHICLE_STATE), (TRUTH,)


def ear(hosts: TwoHosts, where: str, topics: tuple[Any, ...]) -> Any:
    profile = str(hosts.folder / f"{where}.toml")
    heard = hosts.end(where, "ear", profile, "watcher", "0", *(f"+{t.key}" for t in topics), stdin=subprocess.PIPE)
    read_until(heard, "listening", 60.0)
    return heard


def messages(process: Any, topics: tuple[Any, ...]) -> dict[str, list[Any]]:
    out, _ = process.communicate(timeout=60.0)
    said = lines(out)
    return {t.key: [t.type.model_validate(m["said"]) for m in said if m.get("key") == t.key] for t in topics}


def kill(hosts: TwoHosts, where: str) -> float:
    """And start it again; when it was killed."""
    os.kill(int(Path(hosts.run_dir(where), "t", f"{where}_gateway.pid").read_text()), signal.SIGKILL)
    killed_s = time.monotonic()
    hosts.gateway(where)
    return killed_s


@pytest.mark.skipif(not can(), reason="needs root, network namespaces and /dev/net/tun")
def test_a_gateway_killed_in_the_walk_takes_the_pull_away_until_it_is_back(tmp_path, monkeypatch):
    with host.real_time(host.TEST):
        heard, begun_s = flown(tmp_path, monkeypatch)
    for where, t_s in begun_s.items():
        window = Window(heard, t_s, t_s + WATCHED_S - 1.0)
        print(f"{where}_gateway: {window}")
        promises.assert_pulled(window)
        promises.assert_backs_off(window, STALE_S)
        sent_s = [t for t, _ in window.all(SETPOINT, -1.0)]
        assert max(b - a for a, b in itertools.pairwise(sent_s)) < GAP_S, "an onboard loop noticed"
        assert window.all(SETPOINT)[-1][1].kind.value == "admittance", f"never back: {window}"


def flown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[dict[str, list[Any]], dict[str, float]]:
    """What was heard on both hosts, and when which gateway was killed."""
    if host.may_go_first():
        monkeypatch.setenv("CLEW_FIFO", str(host.LOOPS))
    make_certificates(tmp_path / "certs")
    profiles = {w: str(write_profile(tmp_path / f"{w}.toml", w, extra=HURRIED)) for w in ("drone", "ground")}
    with TwoHosts(tmp_path) as hosts:
        hosts.shape(delay_ms=5.0, jitter_ms=1.0)
        for where, names in (("drone", DRONE), ("ground", GROUND)):
            hosts.gateway(where)
            for name in names:
                hosts.clew(where, "run", name, "--profile", profiles[where])
        ears = [(ear(hosts, "drone", ONBOARD), ONBOARD), (ear(hosts, "ground", OUTSIDE), OUTSIDE)]
        read_until(hosts.end("ground", "fly", profiles["ground"], "operator", "90", "guiding"), "guiding", 90.0)
        time.sleep(WALKED_S)
        begun_s: dict[str, float] = {}
        for where in ("drone", "ground"):
            time.sleep(1.0)
            begun_s[where] = kill(hosts, where)
            time.sleep(WATCHED_S - 1.0)
        heard = {key: said for end, topics in ears for key, said in messages(end, topics).items()}
    return heard, begun_s
