"""Who may say and hear what over the radio: Zenoh's access rules, generated from the table and the roles. Pure.

Everything that is not written here is refused. Each gateway polices its own links, so both have rules. A rule names
whole keys: a put on a wildcard and a key that is not in the table match none. Sessions on this host's unix sockets are
guarded by the folder's permissions and may do everything.

| role | may say | may hear |
|---|---|---|
| drone, ground | what the table's publishers on that host say; the ground also the operators' commands | all |
| operator | the operator's commands | all |
| viewer | nothing | all but commands |
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from schemas.message import Message
from schemas.topics import OPERATOR, TOPICS, Topic
from services.gateway.radio import ROLES, Role

LINKS = ("quic", "tls")
"""Protocols of the radio's links: all with certificates on both sides."""
COMMANDS, ALIVE, CLOCK = "@cmd/", "@alive/", "@clock/"
REMOTE: dict[str, tuple[Role, ...]] = {"drone": ("ground",), "ground": ("drone", "operator", "viewer")}
"""Which roles come in at the gateway of each host."""
_ALL = (
    "put", "delete", "declare_subscriber", "query", "reply", "declare_queryable",
    "liveliness_token", "liveliness_query", "declare_liveliness_subscriber",
)  # fmt: skip

Rule = dict[str, Any]
Services = Mapping[str, Sequence[str]]
"""Of each host, by its name."""


def says(role: str, services: Services, topics: Iterable[Topic[Message]] = TOPICS) -> list[str]:
    """Keys on which a remote of this role may put."""
    operators = (OPERATOR,) if role in ("ground", "operator") else ()
    voices = {*services.get(role, ()), *operators}
    return [topic.key for topic in topics if topic.publisher in voices]


def hears(role: str, topics: Iterable[Topic[Message]] = TOPICS) -> list[str]:
    """Keys to which a remote of this role may subscribe."""
    return [topic.key for topic in topics if role != "viewer" or not topic.key.startswith(COMMANDS)]


def rules(host: str, services: Services, prefix: str) -> dict[str, list[Rule]]:
    """For each role that comes in at `host`: what it may do there, in Zenoh's terms."""
    clocks = [CLOCK + host]
    return {
        role: [
            _rule(f"{role}-says", prefix, says(role, services), ["put"], ["ingress"]),
            _rule(f"{role}-is-asked", prefix, says(role, services), ["declare_subscriber"], ["egress"]),
            _rule(f"{role}-hears", prefix, hears(role), ["put"], ["egress"]),
            _rule(f"{role}-asks", prefix, hears(role), ["declare_subscriber"], ["ingress"]),
            _rule(f"{role}-is-there", prefix, _tokens(services.get(role, ())), ["liveliness_token"], ["ingress"]),
            _rule(f"{role}-sees", prefix, _tokens(_others(role, services)), ["liveliness_token"], ["egress"]),
            _rule(f"{role}-looks", prefix, [f"{ALIVE}*"], ["liveliness_query", "declare_liveliness_subscriber"]),
            _rule(f"{role}-reads-the-clock", prefix, clocks, ["query"], ["ingress"]),
            _rule(f"{role}-is-told-the-time", prefix, clocks, ["reply", "declare_queryable"], ["egress"]),
            _rule(f"{role}-is-asked-the-time", prefix, [CLOCK + role], ["query"], ["egress"]),
            _rule(f"{role}-tells-the-time", prefix, [CLOCK + role], ["reply", "declare_queryable"], ["ingress"]),
        ]
        for role in REMOTE[host]
    }


def access_control(host: str, names: Sequence[str], services: Services, prefix: str) -> dict[str, Any]:
    """Zenoh's `access_control` for the gateway of `host`; `names` are those of the certificates that may join."""
    by_role = {role: [name for name in names if name.startswith(f"{role}:")] for role in ROLES}
    granted = {role: made for role, made in rules(host, services, prefix).items() if by_role[role]}
    local = _rule("local", prefix, ["**", *(f"{verbatim}**" for verbatim in (COMMANDS, ALIVE, CLOCK))], _ALL)
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [local, *(rule for made in granted.values() for rule in made if rule["key_exprs"])],
        "subjects": [
            {"id": "local", "link_protocols": ["unixsock-stream"]},
            *({"id": r, "link_protocols": LINKS, "cert_common_names": by_role[r]} for r in granted),
        ],
        "policies": [
            {"rules": ["local"], "subjects": ["local"]},
            *({"rules": [q["id"] for q in made if q["key_exprs"]], "subjects": [r]} for r, made in granted.items()),
        ],
    }


def _others(role: str, services: Services) -> list[str]:
    return [name for host, names in services.items() if host != role for name in names]


def _tokens(names: Iterable[str]) -> list[str]:
    return [ALIVE + name for name in names]


def _rule(
    name: str, prefix: str, keys: Iterable[str], messages: Sequence[str], flows: Sequence[str] = ("ingress", "egress")
) -> Rule:
    return {
        "id": name,
        "permission": "allow",
        "messages": list(messages),
        "flows": list(flows),
        "key_exprs": [prefix + key for key in keys],
    }
