"""What a fault is: a name, a moment, what is done, and what the system must do about it, by when."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum

from schemas.safety import Phase
from services.config import Config
from services.rehearsal.chain import Stage
from services.simulator.human import Event


class Reaction(StrEnum):
    """What a fault must lead to. Each also counts as done where a graver one was."""

    NOTHING = "nothing"  # and nothing above warn
    LET_GO = "no sideways force"
    EASE = "ease"
    HOLD = "hold"
    HANDS_OFF = "no more set-points"
    LAND = "land"
    AUTOPILOT_LANDS = "autopilot lands"
    DISARMED = "motors off"
    STAYS_DOWN = "stays on the ground"
    ANY = "within the limits"  # no reaction is asked for; what must always hold, must


class Group(StrEnum):
    """What breaks."""

    PROCESS = "process"
    BUS = "bus"
    SENSING = "sensing"
    VEHICLE = "vehicle"
    PERSON = "person"
    CLOCK = "clock"
    OPERATOR = "operator"


@dataclass(frozen=True)
class Moment:
    """`after_s` into a phase; what happens in the same moment is flown from one and the same state."""

    phase: Phase
    after_s: float = 0.5


GUIDING = Moment(Phase.GUIDING, 3.0)


@dataclass(frozen=True)
class OnPx4:
    """What is otherwise where real PX4 flies, with the reason."""

    not_flown: str = ""
    """Why PX4 cannot be made to do it; empty where it can."""
    late_s: float = 0.0
    """By so much it may react later."""
    late: str = ""
    exempt: dict[str, str] = field(default_factory=dict[str, str])
    """Limits that it does not keep, besides those that nothing can."""


@dataclass(frozen=True)
class Fault:
    """A row of the campaign. `act` is done at the moment, or with a person's first deed; a wrong world is so from the start."""

    name: str
    group: Group
    about: str
    reaction: Reaction
    within_s: float
    act: Callable[[Stage], None] = lambda stage: None
    moment: Moment = GUIDING
    watch_s: float = 5.0
    deeds: tuple[Event, ...] = ()
    world: Callable[[Config], Config] | None = None
    pull_max_N: float = float("inf")
    """On the hand, where nobody pulls but the system; what a person adds is not promised."""
    exempt: dict[str, str] = field(default_factory=dict[str, str])
    """Limits that no software can keep here, each with the reason; measured and shown all the same."""

    on_px4: OnPx4 = OnPx4()
    family: str = ""
    """What faults that are alike have in common; they share a row in the documentation."""

    def __post_init__(self) -> None:
        """A fault that is like no other is its own family."""
        if not self.family:
            object.__setattr__(self, "family", self.name)

    @property
    def alone(self) -> bool:
        """Whether it needs a flight of its own from the start."""
        return self.world is not None
