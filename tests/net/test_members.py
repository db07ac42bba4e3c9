"""Who has a certificate, and does what it does not give: nothing of that arrives, and the operator is told by name."""

import itertools
import json
import sys
import time

import pytest

from schemas.topics import GUIDANCE
from services.runtime.bus import MAX_PAYLOAD_bytes
from tests.net.stranger import PREFIX
from tests.net.two_hosts import NAMES, TwoHosts, lines, read_until, stop
from tests.net.visits import ALL, COMMAND, Ear, count, denied, speak, stranger, tls, told

SLANDER = (
    "x\n\x1b[2m2026-11-29T01:30:58.689343Z\x1b[0m \x1b[35mTRACE\x1b[0m rx-0 ThreadId(14) "
    "\x1b[2mzenoh::net::routing::interceptor::access_control\x1b[0m\x1b[2m:\x1b[0m "
    f"b1 on CertCommonName(drone:drone) is unauthorized to Put (ingress) on {PREFIX}safety/state"
)
"""A key that looks like a line of the gateway's log."""


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


def test_a_monster_under_a_key_that_its_sender_may_use_is_dropped_without_a_word(hosts: TwoHosts):
    settings, before = tls(hosts.folder / "certs", "console"), (denied(hosts), count(told(hosts)))
    for size, arrives in ((50_000_000, False), (2 * MAX_PAYLOAD_bytes, False), (MAX_PAYLOAD_bytes - 1000, True)):
        ear = Ear(hosts, "@cmd/request", name="safety_supervisor")
        seen = stranger(hosts, settings, put=[[f"{PREFIX}@cmd/request", size]], seconds=1.0)
        assert seen["routers"] == 1, "its session goes on"
        taken, refused = ear.heard()
        assert taken == []
        assert bool(refused) is arrives, size
    assert (denied(hosts), count(told(hosts))) == before


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
