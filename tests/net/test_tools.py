"""What an operator looks with: `clew link` on a host, `clew status` from a console over the radio."""

import json

import pytest

from schemas.topics import CABLE_FORCE
from tests.net.two_hosts import CLEW, TwoHosts, read_until


def clew(hosts: TwoHosts, host: str, *words: str) -> tuple[int, str, str]:
    return hosts.run(host, *CLEW, *words)


def test_link_tells_the_radio_in_numbers(hosts: TwoHosts):
    hosts.shape(delay_ms=20.0, jitter_ms=0.0, loss=0.0, rate_Mbit_s=0.0)
    profile = {host: str(hosts.folder / f"{host}.toml") for host in ("drone", "ground")}
    voice = hosts.end("drone", "voice", profile["drone"], "force_estimator", CABLE_FORCE.key, "250", "12")
    read_until(voice, "speaking")
    code, out, _ = clew(hosts, "ground", "link", "--profile", profile["ground"], "--json")
    told = json.loads(out)
    assert (code, told["up"]) == (0, True)
    assert 40.0 <= told["round_trip_ms"] < 400.0
    assert told["connects"] >= 1
    assert abs(told["clock_offset_s"]) > 1000.0
    force = told["topics"][CABLE_FORCE.key]
    assert force["thinned"]
    assert force["rate_Hz"] == pytest.approx(CABLE_FORCE.radio_Hz, rel=0.3)
    assert 15.0 < force["age_p50_ms"] < 400.0
    code, out, _ = clew(hosts, "ground", "link", "--profile", profile["ground"])
    assert code == 0
    assert "thinned" in out


def test_a_system_on_one_host_has_no_link_to_show(hosts: TwoHosts):
    code, _, complaint = clew(hosts, "ground", "link", "--profile", "demo")
    assert code == 2
    assert "has no radio" in complaint


def test_a_console_sees_the_system_over_the_radio_and_its_ages_are_right(hosts: TwoHosts):
    """From the drone's side of the radio, whose clock is another than the ground's."""
    hosts.shape(delay_ms=5.0, jitter_ms=1.0)
    _, out, complaint = clew(hosts, "drone", "status", "--profile", str(hosts.folder / "console.toml"))
    rows = {
        name: next(line for line in out.splitlines() if name in line) for name in ("drone_gateway", "ground_gateway")
    }
    assert all("yes" in row and "silent" not in row for row in rows.values()), complaint
    assert "operator:console" in rows["ground_gateway"]
