"""The radio section of a profile: where the two hosts meet, who may join, and what the radio may cost."""

from collections.abc import Mapping
from typing import Annotated, Literal

from annotated_types import Gt, Lt

from schemas.topics import GATEWAYS, SERVICES
from services.parameters import NonNegative, Positive, parameters

Role = Literal["drone", "ground", "operator", "viewer"]
ROLES: tuple[Role, ...] = ("drone", "ground", "operator", "viewer")
CONSOLE = "console"
"""The `host` of a machine that is neither."""
Port = Annotated[int, Gt(0), Lt(65536)]


@parameters
class Host:
    """What runs on one of the two hosts, in the order of its start."""

    services: tuple[str, ...]


@parameters
class Radio:
    """One link between two hosts; consoles come in on the ground's side."""

    address: str
    """Where the ground station listens: the name or IP that is in its certificate."""
    ports: tuple[Port, Port, Port, Port]
    """UDP: for guidance, for guidance again, for samples, states and commands; TCP: for bulk."""
    names: tuple[str, ...]
    """Who may join, as their certificates say: `role:name`. Whoever is taken out is shut out from the next start on."""
    console: str = ""
    """The certificate of this machine where it is neither of the hosts but a person's console."""
    delay_allowed_s: NonNegative
    """What may be added to the age of what crossed the radio before it is stale."""
    connect_s: Positive
    """An attempt to connect that has not succeeded by then is made anew: about eight round trips are needed."""
    ask_period_s: Positive
    """Between two comparisons of the clocks."""
    drift_per_s: NonNegative
    """How fast the clocks of two hosts may part: widens what is known between comparisons."""
    lost_s: Positive
    """Without an answer for this long the link counts as down."""

    def of_role(self, role: str) -> list[str]:
        """Names of certificates that may join as this."""
        return [name for r, _, name in (each.partition(":") for each in self.names) if r == role]

    def role_of(self, name: str) -> str:
        """As what a certificate may join; empty where it may not."""
        return next((role for role in ROLES if name in self.of_role(role)), "")


def check_hosts(hosts: Mapping[str, Host], radio: Radio | None, here: str) -> None:
    """Whether two hosts can work together: each with its gateway, no service on both, and this one among them.

    Raises:
        ValueError: key, value and limit.
    """
    if set(hosts) != set(GATEWAYS):
        raise ValueError(f"hosts = {', '.join(sorted(hosts))}: must be {' and '.join(GATEWAYS)}")
    if radio is None:
        raise ValueError("radio: is missing, for two hosts")
    for each in radio.names:
        role, _, name = each.partition(":")
        if role not in ROLES or not name:
            raise ValueError(f"radio.names: {each!r}: must be role:name, with a role of {', '.join(ROLES)}")
    running = [(host, name) for host, each in hosts.items() for name in each.services]
    for host, name in running:
        if [other for _, other in running].count(name) > 1:
            raise ValueError(f"hosts.{host}.services: {name} runs twice, must be on one host and once")
        if name not in SERVICES:
            raise ValueError(f"hosts.{host}.services: {name}: must be one of {', '.join(SERVICES)}")
    for host, gateway in GATEWAYS.items():
        if gateway not in hosts[host].services:
            raise ValueError(f"hosts.{host}.services: must contain {gateway}")
    if here not in (*GATEWAYS, CONSOLE):
        raise ValueError(f"system.host = {here!r}: must be one of {', '.join(GATEWAYS)}, {CONSOLE}")


def common_name(role: str, name: str) -> str:
    """As a certificate carries it: what it may do is part of the name that is signed."""
    return f"{role}:{name}"
