"""The experiment itself, split over two hosts: what an outage of the radio, or a dead gateway, does in the middle of the walk."""

import itertools
import math
import subprocess
import time
from typing import Any

import pytest

from schemas.safety import Level
from schemas.topics import GUIDANCE, SAFETY_STATE, SETPOINT, TOPICS, TRUTH
from schemas.vehicle import SetpointKind
from tests.net.conftest import AHEAD_s, linked
from tests.net.two_hosts import TwoHosts, lines, read_until, stop, write_profile

pytestmark = pytest.mark.faults

OUTAGE_s, WALKED_s, AFTER_s, WEIGHED_s = 2.0, 8.0, 3.0, 2.0
SLACK_s, CALM_N = 1.0, 0.3  # a handle that is held weighs as much
GROUND, DRONE = (
    ("simulator", "tracker", "guiding_controller"),
    ("px4_bridge", "force_estimator", "safety_supervisor"),
)
HURRIED = """clear_of_start_m = 0.5
[safety_supervisor.times]
settle_s = 0.5
held_s = 1.0
fast_mps = 1.2
[force_estimator.bias]
tare_s = 2.0
tare_std_max_N = 0.6
"""


@pytest.fixture
def profiles(hosts: TwoHosts) -> dict[str, str]:
    """The tests' profiles with shorter waits."""
    return {
        host: str(write_profile(hosts.folder / f"hurried_{host}.toml", host, extra=HURRIED))
        for host in ("drone", "ground")
    }


@pytest.fixture
def walking(hosts: TwoHosts, profiles: dict[str, str]) -> None:
    """Everything runs, and the person has been guided for a while."""
    hosts.shape(delay_ms=20.0, jitter_ms=5.0, loss=0.0, rate_Mbit_s=5.0, down=False)
    linked(hosts)
    for host, names in (("ground", GROUND), ("drone", DRONE)):
        for name in names:
            hosts.clew(host, "run", name, "--profile", profiles[host])
    pilot = hosts.end("ground", "fly", profiles["ground"], "operator", "60", "guiding")
    read_until(pilot, "guiding", 70.0)
    time.sleep(WALKED_s)


def listener(hosts: TwoHosts, profiles: dict[str, str], host: str, *keys: str) -> subprocess.Popen[str]:
    """Hears until it is asked."""
    ear = hosts.end(host, "ear", profiles[host], "watcher", "0", *keys, stdin=subprocess.PIPE)
    read_until(ear, "listening")
    return ear


def said(hosts: TwoHosts, ear: subprocess.Popen[str], key: str) -> list[dict[str, Any]]:
    out, _ = ear.communicate(timeout=60.0)
    hosts.processes.remove(ear)
    return [entry["said"] for entry in lines(out) if entry.get("key") == key]


def used_Mbit_s(hosts: TwoHosts) -> dict[str, float]:
    """Of the radio each way, while nothing happens to it."""
    before = hosts.shape()
    time.sleep(WEIGHED_s)
    sizes = [{way: sum(size for _, size in told[way].values()) for way in told} for told in (before, hosts.shape())]
    return {way: (sizes[1][way] - sizes[0][way]) * 8e-6 / WEIGHED_s for way in before}


def norm(vector: dict[str, float]) -> float:
    return math.hypot(*vector.values())


def test_an_outage_in_the_walk_takes_the_pull_away_and_stops_nothing_onboard_and_the_radio_has_room(
    hosts: TwoHosts, profiles: dict[str, str], walking: None
):
    near = listener(hosts, profiles, "drone", f"+{SETPOINT.key}")
    others = [topic.key for topic in TOPICS if topic.logged and topic is not TRUTH]  # as a recorder hears them
    far = listener(hosts, profiles, "ground", f"+{TRUTH.key}", *others)
    used = used_Mbit_s(hosts)
    hosts.shape(down=True)
    cut_s = time.monotonic()
    time.sleep(OUTAGE_s)
    hosts.shape(down=False)
    back_s = time.monotonic()
    time.sleep(AFTER_s)
    sent = [(m["stamp_ns"] * 1e-9 - AHEAD_s, m["inputs"].get(GUIDANCE.key, 0)) for m in said(hosts, near, SETPOINT.key)]
    felt = [(m["stamp_ns"] * 1e-9, norm(m["hand_force_N"])) for m in said(hosts, far, TRUTH.key)]

    gap_s = max(b - a for (a, _), (b, _) in itertools.pairwise(sent))
    known = max(seq for t, seq in sent if t < back_s)
    flows_s = min(t for t, seq in sent if t > back_s and seq > known) - back_s
    before, during = (max(f for t, f in felt if a <= t <= b) for a, b in ((cut_s - 0.5, cut_s), (cut_s, back_s)))
    late = max(f for t, f in felt if cut_s + 0.5 * OUTAGE_s <= t <= back_s)
    print(
        f"guidance {flows_s:.2f} s after the radio; onboard gap {gap_s * 1e3:.0f} ms; "
        f"force {before:.2f} N before, {during:.2f} N at most in the outage, {late:.2f} N in its second half"
    )
    print(f"radio: {used['up']:.2f} Mbit/s up, {used['down']:.2f} down")
    assert max(used.values()) < 1.0
    assert gap_s < 0.1 * OUTAGE_s
    assert flows_s < 0.5 * OUTAGE_s
    assert during < 1.02 * before
    assert late < 0.5 * before


@pytest.mark.parametrize("host", ["ground", "drone"])
def test_a_gateway_that_dies_in_the_walk_takes_the_pull_away_and_the_vehicle_comes_down(
    hosts: TwoHosts, profiles: dict[str, str], walking: None, host: str
):
    near = listener(hosts, profiles, "drone", f"+{SETPOINT.key}")
    judge = listener(hosts, profiles, "drone", f"+{SAFETY_STATE.key}")
    far = listener(hosts, profiles, "ground", f"+{TRUTH.key}")
    witness = hosts.end("drone", "until", profiles["drone"], "witness", "60", "landed")
    time.sleep(0.5)
    with hosts.without_gateway(host):
        dead_s = time.monotonic()
        read_until(witness, "landed", 60.0)
    stop(witness)
    hosts.processes.remove(witness)
    sent, judged = (
        [(m["stamp_ns"] * 1e-9 - AHEAD_s - dead_s, m) for m in said(hosts, ear, topic.key)]
        for ear, topic in ((near, SETPOINT), (judge, SAFETY_STATE))
    )
    felt = [(m["stamp_ns"] * 1e-9 - dead_s, norm(m["hand_force_N"])) for m in said(hosts, far, TRUTH.key)]

    slack_s = next(t for t, m in sent if t > 0.0 and m["kind"] in (SetpointKind.EASE, SetpointKind.HOLD))
    descends_s = next(t for t, m in judged if t > 0.0 and m["level"] >= Level.DESCEND)
    before, during, calm = (
        max(f for t, f in felt if a <= t <= b) for a, b in ((-0.5, 0.0), (0.0, descends_s), (SLACK_s, descends_s))
    )
    print(
        f"{host} gateway dead: slack after {slack_s:.2f} s, descends after {descends_s:.2f} s; "
        f"force {before:.2f} N before, {during:.2f} N at most after it, {calm:.2f} N from {SLACK_s:g} s on"
    )
    assert before > 0.5, "nothing was pulling"
    assert slack_s < 0.5 * SLACK_s
    assert during < 1.02 * before
    assert calm < CALM_N
