"""How the session that owns the radio is set up: a router on mutual TLS, four links split by priority, thinned telemetry.

A link that sends again what was lost holds up all that follows. So what is soon followed by a newer one (commands of
guidance, samples) goes in QUIC datagrams, which are not sent again; a command of guidance goes along with the next one too,
over another link, so that losing it takes two losses. Each QUIC link has a congestion window of its own, which loss keeps
at its least: two datagrams.
States and commands of a person are reliable, over the third. Bulk has a TCP stream, whose small receive buffer keeps it
from filling the radio's queue in front of everybody.
"""

from typing import Any

from schemas.topics import TOPICS
from services.gateway.access import LINKS, Services, access_control
from services.gateway.certs import Credentials
from services.gateway.radio import Radio
from services.runtime.bus import MAX_PAYLOAD_bytes
from services.runtime.zenoh_bus import LEASE_ms

_DATAGRAMS, _STREAM = "#initial_mtu=1400", "#so_sndbuf=4096;so_rcvbuf=8192"
_LINKS = (
    ("quic", f"mixed_rel=1;prio=1-1{_DATAGRAMS}"),
    ("quic", f"mixed_rel=1;prio=2-2{_DATAGRAMS}"),
    ("quic", f"mixed_rel=1;prio=3-5{_DATAGRAMS}"),
    ("tls", f"prio=6-7{_STREAM}"),
)
"""Priorities as the bus gives them to the stances (runtime/zenoh_bus.py)."""
_LEASE_of_connect = 3 / 8
"""A link is dead after three round trips of silence, where connecting takes eight: the first sign of life comes after one
and a quarter of the lease, and a lease that is shorter than that ends a link as soon as it is made."""
BATCH_bytes = 2_048
"""What is handed to a link at a time: more stands in front of a sample for longer."""
MESSAGE_MAX_bytes = 262_144
"""Larger than any message of the table; a link that brings a larger one is closed."""


def endpoints(radio: Radio) -> tuple[str, ...]:
    """One for each priority range.

    Zenoh makes a link anew that was lost alone only where its endpoint has no options. Here it shall not: after an outage
    about as long as the lease one side may begin a new session which the other takes for links of the old, and then
    nothing is routed until the radio is next lost. So a lost link is told, and the others carry what it carried.
    """
    return tuple(
        f"{protocol}/{radio.address}:{port}?{how}" for port, (protocol, how) in zip(radio.ports, _LINKS, strict=True)
    )


def gateway(host: str, radio: Radio, services: Services, files: Credentials, prefix: str) -> dict[str, Any]:
    """Zenoh's settings of the gateway of `host`, beyond a peer's."""
    return _tls(radio, files) | {
        "mode": "router",
        "transport/unicast/open_timeout": round(radio.connect_s * 1e3),
        "listen/timeout_ms": -1,
        "listen/exit_on_failure": False,
        "transport/link/tls/listen_certificate": str(files.certificate),
        "transport/link/tls/listen_private_key": str(files.key),
        "access_control": access_control(host, radio.names, services, prefix),
        "downsampling": [_downsampling(prefix)],
        "low_pass_filter": [_low_pass(prefix)],
    }


def console(radio: Radio, files: Credentials) -> dict[str, Any]:
    """Of a person's machine that is neither host: a client of the ground's gateway."""
    return _tls(radio, files) | {"mode": "client"}


def _tls(radio: Radio, files: Credentials) -> dict[str, Any]:
    return {
        "transport/link/protocols": [*LINKS, "unixsock-stream"],
        "transport/link/tx/batch_size": BATCH_bytes,
        "transport/link/tx/lease": max(LEASE_ms, round(_LEASE_of_connect * radio.connect_s * 1e3)),
        "transport/unicast/max_links": len(_LINKS),
        "transport/unicast/compression/enabled": True,
        "transport/link/rx/max_message_size": MESSAGE_MAX_bytes,
        "transport/link/tls/enable_mtls": True,
        "transport/link/tls/root_ca_certificate": str(files.ca),
        "transport/link/tls/connect_certificate": str(files.certificate),
        "transport/link/tls/connect_private_key": str(files.key),
        "transport/link/tls/verify_name_on_connect": True,
        "transport/link/tls/close_link_on_expiration": True,
    }


def _downsampling(prefix: str) -> dict[str, Any]:
    """One rule for each key: keys that share a rule share its limiter."""
    rules = [{"key_expr": prefix + topic.key, "freq": topic.radio_Hz} for topic in TOPICS if topic.radio_Hz]
    return {"id": "radio", "link_protocols": LINKS, "flows": ["egress"], "messages": ["put"], "rules": rules}


def _low_pass(prefix: str) -> dict[str, Any]:
    keys = [prefix + topic.key for topic in TOPICS]
    limit: dict[str, Any] = {"id": "monsters", "link_protocols": LINKS, "flows": ["ingress"], "messages": ["put"]}
    return limit | {"key_exprs": keys, "size_limit": MAX_PAYLOAD_bytes}
