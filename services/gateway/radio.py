"""The radio section of a profile: where the two hosts meet, who may join, and what the radio may cost."""

from typing import Annotated, Literal

from annotated_types import Gt, Lt

from services.parameters import NonNegative, Positive, parameters

Role = Literal["drone", "ground", "operator", "viewer"]
ROLES: tuple[Role, ...] = ("drone", "ground", "operator", "viewer")
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
    ports: tuple[Port, Port]
    """For samples, states and commands; for bulk."""
    names: dict[str, Role]
    """Who may join, by the name of the certificate; whoever is taken out is shut out from the next start on."""
    console: str = ""
    """The certificate of this machine where it is neither of the hosts but a person's console."""
    delay_allowed_s: NonNegative
    """What may be added to the age of what crossed the radio before it is stale."""
    ask_period_s: Positive
    """Between two comparisons of the clocks."""
    drift_per_s: NonNegative
    """How fast the clocks of two hosts may part: widens what is known between comparisons."""
    lost_s: Positive
    """Without an answer for this long the link counts as down."""


def common_name(role: str, name: str) -> str:
    """As a certificate carries it: what it may do is part of the name that is signed."""
    return f"{role}:{name}"
