"""Who may move the drone, how, and why not more."""

from enum import IntEnum, StrEnum

from schemas.message import Message, Vec3


class Phase(StrEnum):
    """The experiment, step by step."""

    IDLE = "idle"
    TAKEOFF = "takeoff"
    ZEROING = "zeroing"
    READY = "ready"
    GUIDING = "guiding"
    ARRIVED = "arrived"
    CLEARING = "clearing"
    LANDING = "landing"
    LANDED = "landed"
    HOLD = "hold"
    KILLED = "killed"


class Level(IntEnum):
    """How far the system has backed off; a command can only raise it."""

    OK = 0
    WARN = 1
    EASE = 2
    HOLD = 3
    LAND = 4
    DESCEND = 5
    KILL = 6
    """Motors off, in the air too. Only a person asks for it: an operator here, or a pilot at the radio control."""


class Permit(StrEnum):
    """What the bridge may do now."""

    NONE = "none"
    POSITION = "position"
    WAIT = "wait"
    GUIDE = "guide"
    EASE = "ease"
    HOLD = "hold"
    LAND = "land"
    KILL = "kill"


class SafetyState(Message):
    """The supervisor's verdict; everyone obeys the newest valid one and nobody obeys a stale one.

    `POSITION` flies to `goal_m` at `speed_mps`. `WAIT` engages the filter anchored over the start; `GUIDE` lets guidance
    act; `EASE` gives way, `HOLD` stands with the cable slack. `KILL` stops the motors. `reasons` holds what limits the
    system now, the most important first.
    """

    phase: Phase
    level: Level
    permit: Permit
    goal_m: Vec3
    speed_mps: float
    tare: bool
    held: bool
    reasons: list[str]
    stalls: int
    """How often this host took the processor away for longer than the loops tolerate."""


class Action(StrEnum):
    """What an operator can ask for."""

    START = "start"
    EASE = "ease"
    HOLD = "hold"
    LAND = "land"
    KILL = "kill"
    RESUME = "resume"


RAISES = {Action.EASE: Level.EASE, Action.HOLD: Level.HOLD, Action.LAND: Level.LAND, Action.KILL: Level.KILL}
"""The level that a command raises to; `resume` gives it back, below LAND."""


class OperatorRequest(Message):
    """A person's command; repeated by its sender until a safety state answers with the same `request_id` as input."""

    action: Action
    operator: str
    request_id: int

    @property
    def voice(self) -> str:
        """Each person's console counts for itself."""
        return self.operator


class OperatorReply(Message):
    """The supervisor's answer to a request."""

    request_id: int
    accepted: bool
    text: str
