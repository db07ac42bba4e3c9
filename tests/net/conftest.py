"""One pair of hosts for all tests of this folder, or none, and then each test is skipped by name."""

from collections.abc import Generator

import pytest

from tests.net.two_hosts import NAMES, TwoHosts, can, make_certificates, read_until, stop, write_profile

AHEAD_s = 5000


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """All of them are `net`; without root they cannot run."""
    for item in items:
        if "tests/net/" in str(item.path):
            item.add_marker("net")
            if not can():
                item.add_marker(pytest.mark.skip(reason="needs root, network and time namespaces, and /dev/net/tun"))


@pytest.fixture(scope="session")
def bare(tmp_path_factory) -> Generator[TwoHosts]:
    """Two hosts with certificates and profiles, the radio good; nothing runs yet. The drone's clock is 5000 s ahead."""
    folder = tmp_path_factory.mktemp("net")
    make_certificates(folder / "certs", {**NAMES, "old": "viewer"})
    for host in ("drone", "ground", "console"):
        write_profile(folder / f"{host}.toml", host)
    with TwoHosts(folder, drone_ahead_s=AHEAD_s) as hosts:
        hosts.shape(delay_ms=5, jitter_ms=1)
        yield hosts


@pytest.fixture(scope="module")
def hosts(bare: TwoHosts) -> Generator[TwoHosts]:
    """The same with both gateways up and linked."""
    bare.shape(delay_ms=5, jitter_ms=1, loss=0.0, rate_Mbit_s=0, down=False)
    before = len(bare.processes)
    bare.gateway("drone")
    bare.gateway("ground")
    linked(bare)
    yield bare
    for process in reversed(bare.processes[before:]):
        stop(process)
    del bare.processes[before:]


@pytest.fixture(autouse=True)
def nobody_left(hosts: TwoHosts) -> Generator[None]:
    """What a test that failed left running does not disturb the next."""
    before = list(hosts.processes)
    yield
    for process in [each for each in hosts.processes if each not in before and "gateway" not in str(each.args)]:
        stop(process)
        hosts.processes.remove(process)


def linked(hosts: TwoHosts, seconds: float = 15.0) -> None:
    """Wait until the two clocks have been compared, as a reader on the ground sees it."""
    ear = hosts.end("ground", "first", str(hosts.folder / "ground.toml"), "watcher", str(seconds), "radio/clock")
    read_until(ear, "radio/clock", seconds)
    stop(ear)
    hosts.processes.remove(ear)
