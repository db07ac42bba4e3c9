"""The radio at its worst: what arrives, how old it is, and that what must not stop does not."""

import itertools
import json
import subprocess
import time
from typing import Any

import pytest

from schemas.topics import CABLE_FORCE, GUIDANCE, HANDLE_STATE, RADIO_CLOCK
from tests.net.conftest import AHEAD_s, linked
from tests.net.two_hosts import TwoHosts, lines, read_until
from tests.net.visits import told

DELAY_s, GUIDANCE_PORT = 0.020, 7447
BAD = {"delay_ms": 1e3 * DELAY_s, "jitter_ms": 5.0, "loss": 0.05, "rate_Mbit_s": 5.0}
LIVES_s = GUIDANCE.lifetime_s + 0.25
"""The time to live of a command, and what the profile lets the radio add."""


def profile(hosts: TwoHosts, host: str) -> str:
    return str(hosts.folder / f"{host}.toml")


def ear(hosts: TwoHosts, host: str, name: str, *keys: str):
    process = hosts.end(host, "ear", profile(hosts, host), name, "0", *keys, stdin=subprocess.PIPE)
    read_until(process, "listening")
    return process


def voice(hosts: TwoHosts, host: str, name: str, key: str, rate_Hz: float, seconds: float, padding: int = 0):
    process = hosts.end(host, "voice", profile(hosts, host), name, key, str(rate_Hz), str(seconds), str(padding))
    read_until(process, "speaking")
    return process


def heard(hosts: TwoHosts, process: Any, *voices: Any) -> tuple[list[dict[str, Any]], dict[str, int]]:
    """What an ear took until the voices had ended, and how much it refused for what reason."""
    for voice in voices:
        voice.communicate(timeout=60.0)
        hosts.processes.remove(voice)
    if voices:
        time.sleep(0.5)  # what is under way still counts
    out, _ = process.communicate(timeout=60.0)
    hosts.processes.remove(process)
    *taken, last = lines(out)
    return taken, last["why"]


def of(taken: list[dict[str, Any]], key: str, what: str) -> list[float]:
    return [entry[what] for entry in taken if entry["key"] == key]


def gaps(times: list[float]) -> list[float]:
    return [b - a for a, b in itertools.pairwise(times)]


def quantile(values: list[float], q: float) -> float:
    return sorted(values)[min(int(q * len(values)), len(values) - 1)]


def test_the_clocks_are_compared_to_within_a_few_milliseconds(hosts: TwoHosts):
    """The hosts are namespaces of one machine, so the true offset is known: what the time namespace adds."""
    hosts.shape(**BAD)
    time.sleep(6.0)
    first = hosts.end("ground", "first", profile(hosts, "ground"), "watcher", "10", RADIO_CLOCK.key)
    said = json.loads(read_until(first, RADIO_CLOCK.key))["said"]
    error_s = abs(said["ground_minus_drone_ns"] * 1e-9 + AHEAD_s)
    assert error_s < said["uncertainty_s"] < 0.05
    assert error_s < 0.02
    assert abs(said["time_of_day_apart_s"]) < 0.2


def test_commands_arrive_on_a_bad_radio_with_bulk_beside_them_and_none_is_acted_on_that_is_too_old(hosts: TwoHosts):
    hosts.shape(**BAD)
    listener = ear(hosts, "drone", "px4_bridge", GUIDANCE.key)
    bulk = ear(hosts, "drone", "safety_supervisor", "sim/truth")
    crowding = voice(hosts, "ground", "simulator", "sim/truth", 400.0, 14.0, 1000)
    guiding = voice(hosts, "ground", "guiding_controller", GUIDANCE.key, 100.0, 12.0)
    taken, refused = heard(hosts, listener, guiding)
    crowd, _ = heard(hosts, bulk, crowding)
    ages, seqs = of(taken, GUIDANCE.key, "age_s"), of(taken, GUIDANCE.key, "seq")
    too_old, overtaken = (sum(n for why, n in refused.items() if word in why) for word in (" old", "out of order"))
    print(f"age p50 {quantile(ages, 0.5) * 1e3:.0f} ms, p99 {quantile(ages, 0.99) * 1e3:.0f} ms, refused: {refused}")
    assert len(crowd) > 500, "there was a crowd, as far as its small window lets it"
    assert len(seqs) > 900
    assert 1.0 - (len(seqs) + sum(refused.values())) / (seqs[-1] - seqs[0] + 1) < 0.01, "lost"
    assert too_old / len(seqs) < 0.02
    # What the radio loses comes again beside the next one, over another link: where that is ahead, it is refused.
    assert overtaken / len(seqs) < BAD["loss"]
    assert max(ages) <= LIVES_s + 0.02, "acted on"
    assert quantile(ages, 0.5) < 0.5 * LIVES_s


def test_an_outage_stops_nothing_onboard_and_leaves_nothing_stale(hosts: TwoHosts):
    """2 s of silence while the drone's own topics go on; then guidance flows again, and nothing old is acted on."""
    hosts.shape(**BAD | {"loss": 0.0})
    onboard = ear(hosts, "drone", "px4_bridge", GUIDANCE.key, CABLE_FORCE.key)
    voices = (
        voice(hosts, "ground", "guiding_controller", GUIDANCE.key, 100.0, 12.0),
        voice(hosts, "drone", "force_estimator", CABLE_FORCE.key, 250.0, 12.0),
    )
    time.sleep(3.0)
    hosts.shape(down=True)
    time.sleep(2.0)
    hosts.shape(down=False)
    back_s = time.monotonic() + AHEAD_s
    taken, _ = heard(hosts, onboard, *voices)
    times = of(taken, GUIDANCE.key, "t_s")
    after = [t for t in times if t > back_s]
    assert after, "it flows again"
    local = gaps(of(taken, CABLE_FORCE.key, "t_s"))
    print(f"guidance {after[0] - back_s:.2f} s after the radio; longest onboard gap {max(local) * 1e3:.0f} ms")
    assert max(gaps(times)) > 1.9, "there was an outage"
    assert max(of(taken, GUIDANCE.key, "age_s")) <= LIVES_s + 0.02
    assert max(local) < 0.25 * max(gaps(times))  # how soon it is back, on an idle machine: make bench-net


def test_a_link_that_is_lost_alone_is_told_and_the_others_carry_on(hosts: TwoHosts):
    """The first of the two that guidance has; what was on its way is lost, no more."""
    hosts.shape(**BAD | {"loss": 0.0})
    listener = ear(hosts, "drone", "px4_bridge", GUIDANCE.key)
    guiding = voice(hosts, "ground", "guiding_controller", GUIDANCE.key, 100.0, 10.0)
    time.sleep(2.0)
    hosts.shape(deaf_port=GUIDANCE_PORT)
    time.sleep(2.0)
    assert "drone:drone by 3 of 4 links only" in told(hosts)
    taken, _ = heard(hosts, listener, guiding)
    hosts.shape(deaf_port=0)
    seqs = of(taken, GUIDANCE.key, "seq")
    assert len(seqs) > 900
    assert len(seqs) / (seqs[-1] - seqs[0] + 1) > 0.95
    assert max(of(taken, GUIDANCE.key, "age_s")) <= LIVES_s + 0.02


@pytest.mark.parametrize("host", ["drone", "ground"])
def test_a_gateway_that_is_killed_comes_back_and_nobody_at_home_notices(hosts: TwoHosts, host: str):
    hosts.shape(**BAD | {"loss": 0.0})
    onboard = ear(hosts, "drone", "px4_bridge", GUIDANCE.key, CABLE_FORCE.key)
    voices = (
        voice(hosts, "ground", "guiding_controller", GUIDANCE.key, 100.0, 13.0),
        voice(hosts, "drone", "force_estimator", CABLE_FORCE.key, 250.0, 13.0),
    )
    time.sleep(2.0)
    with hosts.without_gateway(host):
        killed_s = time.monotonic() + AHEAD_s
    taken, _ = heard(hosts, onboard, *voices)
    times, local = of(taken, GUIDANCE.key, "t_s"), gaps(of(taken, CABLE_FORCE.key, "t_s"))
    after = [t for t in times if t > killed_s + 0.3]
    assert after, "it came back"
    print(f"{host} gateway: guidance {after[0] - killed_s:.2f} s after the kill; onboard gap {max(local) * 1e3:.0f} ms")
    assert max(of(taken, GUIDANCE.key, "age_s")) <= LIVES_s + 0.02
    assert max(local) < 0.5
    linked(hosts)


def test_telemetry_is_thinned_on_the_radio_and_only_there(hosts: TwoHosts):
    hosts.shape(delay_ms=5.0, jitter_ms=1.0, loss=0.0, rate_Mbit_s=0.0)
    far = ear(hosts, "ground", "recorder", CABLE_FORCE.key, HANDLE_STATE.key)
    near = ear(hosts, "drone", "px4_bridge", CABLE_FORCE.key, HANDLE_STATE.key)
    voices = (
        voice(hosts, "drone", "force_estimator", CABLE_FORCE.key, 250.0, 6.0),
        voice(hosts, "ground", "tracker", HANDLE_STATE.key, 60.0, 6.0),
    )
    on_ground, _ = heard(hosts, far, *voices)
    on_drone, _ = heard(hosts, near)

    def rate_Hz(taken: list[dict[str, Any]], key: str) -> float:
        times = of(taken, key, "t_s")
        return (len(times) - 1) / (times[-1] - times[0])

    assert rate_Hz(on_drone, CABLE_FORCE.key) == pytest.approx(250.0, rel=0.05)
    assert rate_Hz(on_ground, CABLE_FORCE.key) == pytest.approx(CABLE_FORCE.radio_Hz, rel=0.1)
    for taken in (on_drone, on_ground):
        assert rate_Hz(taken, HANDLE_STATE.key) == pytest.approx(60.0, rel=0.05)
