"""The experiment itself, split over two hosts: what an outage of the radio, or a dead gateway, does in the middle of the walk."""

import itertools
import math
import os
import subprocess
import time
from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import pytest

from schemas.safety import Level
from schemas.topics import GUIDANCE, SAFETY_STATE, SETPOINT, TOPICS, TRUTH
from schemas.vehicle import SetpointKind
from services.safety_supervisor.rules import RULES
from tests.net.conftest import AHEAD_s, linked
from tests.net.two_hosts import TwoHosts, lines, read_until, stop, write_profile
from tests.processes.host import go_first

pytestmark = [pytest.mark.faults, pytest.mark.timeout(240)]

OUTAGE_s, WALKED_s, AFTER_s, WEIGHED_s = 2.0, 8.0, 3.0, 2.0
SLACK_s, CALM_N, PULLS_N = 1.0, 0.3, 0.5  # a handle that is held weighs 0.3 N
GROUND, DRONE = (
    ("simulator", "tracker", "guiding_controller"),
    ("px4_bridge", "force_estimator", "safety_supervisor"),
)
HOST = tuple(rule.text for rule in RULES if rule.name in ("loop_late", "host_stall"))
HURRIED = """clear_of_start_m = 0.5
[safety_supervisor.times]
settle_s = 0.5
held_s = 1.0
fast_mps = 1.2
[force_estimator.bias]
tare_s = 2.0
tare_std_max_N = 0.6
"""


@dataclass(frozen=True)
class Walk:
    """A person is being guided, and what is heard of it from its start on."""

    hosts: TwoHosts
    near: subprocess.Popen[str]
    far: subprocess.Popen[str]

    def over(self) -> "Heard":
        """What was heard; times are this machine's. Prints what the supervisor said."""
        near, far = said(self.hosts, self.near), said(self.hosts, self.far)
        heard = Heard(
            sent=[(m["stamp_ns"] * 1e-9 - AHEAD_s, m) for m in near[SETPOINT.key]],
            judged=[(m["stamp_ns"] * 1e-9 - AHEAD_s, m) for m in near[SAFETY_STATE.key]],
            guided_s=[m["stamp_ns"] * 1e-9 - AHEAD_s for m in near[GUIDANCE.key]],
            felt_N=[(m["stamp_ns"] * 1e-9, math.hypot(*m["hand_force_N"].values())) for m in far[TRUTH.key]],
        )
        words = [(t, f"{m['phase']}, {Level(m['level']).name}: {'; '.join(m['reasons'])}") for t, m in heard.judged]
        for t, word in [words[0], *(b for a, b in itertools.pairwise(words) if a[1] != b[1])]:
            print(f"{t:.2f} s: {word}")
        return heard


@dataclass(frozen=True)
class Heard:
    """Of one flight: set-points, the supervisor's verdicts, the force on the hand; each with its time, s.

    `guided_s` is when what the drone heard of guidance was said.
    """

    sent: list[tuple[float, dict[str, Any]]]
    judged: list[tuple[float, dict[str, Any]]]
    guided_s: list[float]
    felt_N: list[tuple[float, float]]

    def carried(self, until_s: float) -> None:
        """Skips by name where this machine is too slow for two hosts: the supervisor says so before anything is broken."""
        skip_if_slow("; ".join(text for t, m in self.judged if t < until_s for text in m["reasons"]))

    def most_N(self, begin_s: float, end_s: float) -> float:
        """On the hand."""
        return max(force for t, force in self.felt_N if begin_s <= t <= end_s)


@pytest.fixture
def profiles(hosts: TwoHosts) -> dict[str, str]:
    """The tests' profiles with shorter waits."""
    return {
        host: str(write_profile(hosts.folder / f"hurried_{host}.toml", host, extra=HURRIED))
        for host in ("drone", "ground")
    }


@pytest.fixture
def walk(hosts: TwoHosts, profiles: dict[str, str]) -> Walk:
    """Everything runs, and the person has been guided for a while."""
    hosts.shape(delay_ms=20.0, jitter_ms=5.0, loss=0.0, rate_Mbit_s=5.0, down=False)
    linked(hosts)
    walk = Walk(
        hosts,
        near=listener(hosts, profiles, "drone", *(f"+{topic.key}" for topic in (SETPOINT, SAFETY_STATE, GUIDANCE))),
        far=listener(hosts, profiles, "ground", f"+{TRUTH.key}"),
    )
    for host, names in (("ground", GROUND), ("drone", DRONE)):
        go_first(hosts.gateway_pid(host))
        for name in names:
            hosts.service(host, name, profiles[host])
    pilot = hosts.end("ground", "fly", profiles["ground"], "operator", "60", "guiding", preexec_fn=gives_way)
    try:
        read_until(pilot, "reached guiding", 70.0)
    except AssertionError as why:
        skip_if_slow(str(why))
        raise
    time.sleep(WALKED_s)
    return walk


def skip_if_slow(said: str) -> None:
    """If the supervisor blames the host, which nobody has broken."""
    if blamed := [text for text in HOST if text in said]:
        pytest.skip(f"this machine does not carry two hosts: {', '.join(blamed)}")


def gives_way() -> None:
    """Who only listens takes nothing from those that fly."""
    os.nice(10)


def listener(hosts: TwoHosts, profiles: dict[str, str], host: str, *keys: str) -> subprocess.Popen[str]:
    """Hears until it is asked."""
    ear = hosts.end(host, "ear", profiles[host], "watcher", "0", *keys, stdin=subprocess.PIPE, preexec_fn=gives_way)
    read_until(ear, "listening")
    return ear


def said(hosts: TwoHosts, ear: subprocess.Popen[str]) -> dict[str, list[dict[str, Any]]]:
    """Each topic's messages."""
    out, _ = ear.communicate(timeout=60.0)
    hosts.processes.remove(ear)
    by_key = defaultdict[str, list[dict[str, Any]]](list)
    for entry in lines(out):
        if "said" in entry:
            by_key[entry["key"]].append(entry["said"])
    return by_key


def used_Mbit_s(hosts: TwoHosts) -> dict[str, float]:
    """Of the radio each way, while nothing happens to it."""
    before = hosts.shape()
    time.sleep(WEIGHED_s)
    sizes = [{way: sum(size for _, size in told[way].values()) for way in told} for told in (before, hosts.shape())]
    return {way: (sizes[1][way] - sizes[0][way]) * 8e-6 / WEIGHED_s for way in before}


def test_an_outage_in_the_walk_takes_the_pull_away_and_stops_nothing_onboard_and_the_radio_has_room(
    hosts: TwoHosts, profiles: dict[str, str], walk: Walk
):
    recorded = [topic.key for topic in TOPICS if topic.logged and topic is not TRUTH]
    recorder = listener(hosts, profiles, "ground", *recorded)
    used = used_Mbit_s(hosts)
    stop(recorder)
    hosts.processes.remove(recorder)
    hosts.shape(down=True)
    cut_s = time.monotonic()
    time.sleep(OUTAGE_s)
    hosts.shape(down=False)
    back_s = time.monotonic()
    time.sleep(AFTER_s)
    heard = walk.over()

    gap_s = max(b - a for (a, _), (b, _) in itertools.pairwise(heard.sent) if b > cut_s)
    flows_s = min((t for t in heard.guided_s if t > cut_s + 0.5 * OUTAGE_s), default=math.inf) - back_s
    before, during = heard.most_N(cut_s - 0.5, cut_s), heard.most_N(cut_s, back_s)
    late = heard.most_N(cut_s + 0.5 * OUTAGE_s, back_s)
    print(
        f"cut at {cut_s:.2f} s; guidance {flows_s:.2f} s after the radio; onboard gap {gap_s * 1e3:.0f} ms; "
        f"force {before:.2f} N before, {during:.2f} N at most in the outage, {late:.2f} N in its second half"
    )
    print(f"radio: {used['up']:.2f} Mbit/s up, {used['down']:.2f} down")
    assert max(used.values()) < 1.0
    heard.carried(cut_s)
    assert before > PULLS_N, "nothing was pulling"
    assert gap_s < 0.1 * OUTAGE_s
    assert flows_s < 0.5 * OUTAGE_s
    assert during < 1.02 * before
    assert late < 0.5 * before


@pytest.mark.parametrize("host", ["ground", "drone"])
def test_a_gateway_that_dies_in_the_walk_takes_the_pull_away_and_the_vehicle_comes_down(
    hosts: TwoHosts, profiles: dict[str, str], walk: Walk, host: str
):
    witness = hosts.end("drone", "until", profiles["drone"], "witness", "60", "landed", preexec_fn=gives_way)
    with hosts.without_gateway(host):
        dead_s = time.monotonic()
        read_until(witness, "reached landed", 60.0)
    heard = walk.over()

    slack_s = next(t for t, m in heard.sent if t > dead_s and m["kind"] in (SetpointKind.EASE, SetpointKind.HOLD))
    descends_s = next(t for t, m in heard.judged if t > dead_s and m["level"] >= Level.DESCEND)
    before, during = heard.most_N(dead_s - 0.5, dead_s), heard.most_N(dead_s, descends_s)
    calm = heard.most_N(dead_s + SLACK_s, descends_s)
    print(
        f"{host} gateway dead at {dead_s:.2f} s; slack after {slack_s - dead_s:.2f} s, descends after "
        f"{descends_s - dead_s:.2f} s; force {before:.2f} N before, {during:.2f} N at most after it, "
        f"{calm:.2f} N from {SLACK_s:g} s on"
    )
    heard.carried(dead_s)
    assert before > PULLS_N, "nothing was pulling"
    assert slack_s - dead_s < 0.5 * SLACK_s
    assert during < 1.02 * before
    assert calm < CALM_N
