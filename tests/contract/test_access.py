"""The access rules of both gateways say what the table says: checked by an evaluator that knows nothing of how they are made."""

import itertools
from dataclasses import replace
from pathlib import Path

import pytest

from schemas.topics import BY_KEY, OPERATOR, TOPICS
from services.config import load
from services.gateway import session
from services.gateway.access import REMOTE, access_control
from services.gateway.certs import Credentials
from services.gateway.radio import ROLES

PREFIX = "clew/@v1/t/"
CONFIG = load("ground")
SERVICES = {host: each.services for host, each in CONFIG.hosts.items()}
HOST_OF = {name: host for host, names in SERVICES.items() for name in names}
NAMES = {"d": "drone", "g": "ground", "anna": "operator", "tv": "viewer"}
COMMON = [f"{role}:{name}" for name, role in NAMES.items()]


def may(host: str, who: str, message: str, flow: str, key: str) -> bool:
    """Whether Zenoh would let it pass at the gateway of `host`; keys are compared whole, as its rules name no wildcard."""
    acl = access_control(host, COMMON, SERVICES, PREFIX)
    subjects = {s["id"] for s in acl["subjects"] if f"{NAMES.get(who)}:{who}" in s.get("cert_common_names", ())}
    allowed = {rule for policy in acl["policies"] if subjects & set(policy["subjects"]) for rule in policy["rules"]}
    return any(
        rule["id"] in allowed
        and message in rule["messages"]
        and flow in rule["flows"]
        and PREFIX + key in rule["key_exprs"]
        for rule in acl["rules"]
    )


def remotes():
    return [(host, who) for host in REMOTE for who, role in NAMES.items() if role in REMOTE[host]]


@pytest.mark.parametrize(("host", "who"), remotes())
@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.key)
def test_who_may_say_what(host, who, topic):
    role = NAMES[who]
    own = HOST_OF.get(topic.publisher) == role
    commands = topic.publisher == OPERATOR and role in ("operator", "ground")
    assert may(host, who, "put", "ingress", topic.key) is (own or commands)


@pytest.mark.parametrize(("host", "who"), remotes())
def test_everybody_may_watch_and_a_viewer_hears_no_command(host, who):
    for key in BY_KEY:
        hears = may(host, who, "put", "egress", key) and may(host, who, "declare_subscriber", "ingress", key)
        assert hears is not (NAMES[who] == "viewer" and key.startswith("@cmd/"))


def test_nobody_deletes_and_nobody_else_gets_in():
    for host, flow, key in itertools.product(REMOTE, ("ingress", "egress"), BY_KEY):
        assert not any(may(host, who, "delete", flow, key) for who in NAMES)
        assert not may(host, "eve", "put", flow, key)
        assert access_control(host, COMMON, SERVICES, PREFIX)["default_permission"] == "deny"


def test_a_remote_rule_names_whole_keys_but_for_looking_who_is_there():
    for host in REMOTE:
        for rule in access_control(host, COMMON, SERVICES, PREFIX)["rules"]:
            if rule["id"] != "local" and not rule["id"].endswith("-looks"):
                assert not any("*" in key for key in rule["key_exprs"])


def test_a_token_stands_for_a_service_of_its_own_host():
    assert may("ground", "d", "liveliness_token", "ingress", "@alive/px4_bridge")
    assert not may("ground", "d", "liveliness_token", "ingress", "@alive/tracker")
    assert not may("ground", "tv", "liveliness_token", "ingress", "@alive/px4_bridge")
    assert not may("ground", "anna", "liveliness_token", "ingress", "@alive/px4_bridge")
    assert may("drone", "g", "liveliness_token", "ingress", "@alive/tracker")


def test_a_name_that_is_taken_out_has_no_rule_left():
    acl = access_control("ground", ["drone:d"], SERVICES, PREFIX)
    assert [name for s in acl["subjects"] for name in s.get("cert_common_names", ())] == ["drone:d"]
    assert {rule for policy in acl["policies"] for rule in policy["rules"]} == {rule["id"] for rule in acl["rules"]}


def test_each_thinned_key_has_a_limiter_of_its_own():
    radio = CONFIG.radio
    assert radio is not None
    files = Credentials(Path("ca.pem"), Path("d.pem"), Path("d.key"))
    made = session.gateway("drone", radio, SERVICES, files, PREFIX)
    rules = made["downsampling"][0]["rules"]
    assert {rule["key_expr"] for rule in rules} == {PREFIX + topic.key for topic in TOPICS if topic.radio_Hz}
    assert len(rules) == len({rule["key_expr"] for rule in rules})
    assert not any("*" in rule["key_expr"] for rule in rules)
    assert all(0 < topic.radio_Hz < topic.rate_Hz for topic in TOPICS if topic.radio_Hz)


def test_a_link_lives_long_enough_to_give_a_sign_of_life_over_a_slow_radio():
    """The first keep-alive is sent a quarter of the lease after the answer has come back: one round trip later."""
    radio = CONFIG.radio
    assert radio is not None
    files = Credentials(Path("ca.pem"), Path("d.pem"), Path("d.key"))
    for round_trip_s in (0.0, 0.05, 0.1, 0.4, 0.7):
        slow = replace(radio, connect_s=max(radio.connect_s, 8.0 * round_trip_s))
        lease_s = session.gateway("drone", slow, SERVICES, files, PREFIX)["transport/link/tx/lease"] * 1e-3
        assert lease_s > round_trip_s + 0.25 * lease_s
    assert lease_s < 3.1 * round_trip_s, "and a dead one is noticed"


def test_what_flies_by_the_radio_is_not_thinned():
    for topic in TOPICS:
        readers = {HOST_OF.get(name) for name in topic.subscribers} - {None, HOST_OF.get(topic.publisher)}
        if "drone" in readers:
            assert not topic.radio_Hz


def test_roles_are_those_of_the_certificates():
    assert set(NAMES.values()) == set(ROLES)
