"""What the benchmarks of the radio stand on: two hosts with certificates, and how good or bad the radio is."""

from pathlib import Path

from tests.net.conftest import linked
from tests.net.two_hosts import TwoHosts, make_certificates, write_profile

BAD: dict[str, float] = {"delay_ms": 20.0, "jitter_ms": 5.0, "loss": 0.05, "rate_Mbit_s": 5.0}
QUIET: dict[str, float] = {"delay_ms": 2.0, "jitter_ms": 0.5, "loss": 0.0, "rate_Mbit_s": 0.0}
Row = tuple[str, ...]


def up(folder: Path, radio: str = "", extra: str = "") -> TwoHosts:
    """Two hosts with certificates and profiles; enter it."""
    make_certificates(folder / "certs")
    for host in ("drone", "ground"):
        write_profile(folder / f"{host}.toml", host, radio, extra)
    return TwoHosts(folder)


def gateways(hosts: TwoHosts) -> None:
    """Both, linked over a good radio."""
    hosts.shape(**QUIET)
    hosts.gateway("drone")
    hosts.gateway("ground")
    linked(hosts)
