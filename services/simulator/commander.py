"""The stand-in for PX4's commander: modes, arming, and what happens when set-points or positions stay away.

| PX4 | here | unit |
|---|---|---|
| user intention | intention: the mode that was asked for | |
| failsafe action | failsafe: what overrides it | |
| COM_OF_LOSS_T, COM_OBL_RC_ACT, COM_DISARM_LAND, COM_DISARM_PRFLT | parameters of the same names | s, -, s, s |
| COM_KILL_DISARM, COM_RC_IN_MODE | the same | s, - |

The mode that flies is the failsafe's, else the intended one. A mode asked for while disarmed is always accepted,
offboard without a set-point stream too: accepted is not flying, for arming is then denied. When the stream stops in
flight the mode is left at the first check after COM_OF_LOSS_T plus a latency. What follows is COM_OBL_RC_ACT's
choice: Land stays until the vehicle is disarmed; Hold and the sinking of 0 end, and offboard goes on by itself, as
soon as the stream is back. Sinking does not disarm on the ground either. This is as measured on PX4 main without RC.
A pilot's kill switch stops the motors at once; armed it stays for COM_KILL_DISARM, in which the switch's way back starts them.

Scalar, for one vehicle: it is a state machine, not a law to broadcast.
"""

from collections.abc import Mapping
from enum import Enum, IntEnum
from typing import NamedTuple, TypeAlias

from services.parameters import Positive, parameters


class Mode(Enum):
    """Who steers."""

    OFFBOARD = "offboard"
    HOLD = "hold"
    LAND = "land"
    DESCEND = "descend"


class Failsafe(Enum):
    """What overrides the intended mode. SINK and HOLD end when the stream is back, the others on the ground."""

    NONE = "none"
    HOLD = "hold"
    LAND = "land"
    SINK = "sink"  # offboard lost with nobody at a remote control: descends, stays armed
    BLIND = "blind"  # no position any more: descends


class Ack(IntEnum):
    """The autopilot's word on a request; the values are MAVLink's MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class Arm(NamedTuple):
    """Arm, or disarm; `force` also in the air."""

    armed: bool
    force: bool = False
    ticket: int = 0  # whatever the link needs to answer: the command's number


class Switch(NamedTuple):
    """Ask for a mode."""

    mode: Mode
    ticket: int = 0


class Terminate(NamedTuple):
    """Stop the motors for good."""

    ticket: int = 0


class KillSwitch(NamedTuple):
    """The pilot moves it, at the radio control; nobody answers."""

    on: bool
    ticket: int = 0


class SetOrigin(NamedTuple):
    """Tell where on earth the local origin is; without it Hold is refused."""

    ticket: int = 0


class SetParameter(NamedTuple):
    """Change a parameter; unknown names are denied."""

    name: str
    value: float
    ticket: int = 0


class Unsupported(NamedTuple):
    """A command that this autopilot does not know."""

    ticket: int = 0


Request: TypeAlias = Arm | Switch | Terminate | KillSwitch | SetOrigin | SetParameter | Unsupported
Parameters: TypeAlias = Mapping[str, float]


@parameters
class Commander:
    """How quick it is to notice; set so that PX4's measured times come out."""

    check_period_s: Positive
    loss_latency_s: Positive
    proof_of_life_s: Positive


class CommanderState(NamedTuple):
    """All that decides who steers."""

    intention: Mode = Mode.HOLD
    failsafe: Failsafe = Failsafe.NONE
    armed: bool = False
    terminated: bool = False
    killed: bool = False  # by the switch, until it goes back
    has_origin: bool = False
    has_flown: bool = False
    setpoint_age_s: float = float("inf")
    stream_s: float = 0.0  # how long set-points have come without a gap
    armed_s: float = 0.0
    landed_s: float = 0.0
    killed_s: float = 0.0
    until_check_s: float = 0.0

    @property
    def mode(self) -> Mode:
        """The mode that flies."""
        return _MODE_OF.get(self.failsafe, self.intention)

    @property
    def stopped(self) -> bool:
        """No motor turns, armed or not, and it does not arm."""
        return self.terminated or self.killed


class Situation(NamedTuple):
    """What the commander is told about the vehicle."""

    landed: bool
    has_position: bool


_MODE_OF = {
    Failsafe.HOLD: Mode.HOLD,
    Failsafe.LAND: Mode.LAND,
    Failsafe.SINK: Mode.DESCEND,
    Failsafe.BLIND: Mode.DESCEND,
}
_ON_OFFBOARD_LOSS = {0: Failsafe.SINK, 1: Failsafe.SINK, 2: Failsafe.SINK, 4: Failsafe.LAND, 5: Failsafe.HOLD}
PARAMETERS = (
    "COM_OF_LOSS_T",
    "COM_OBL_RC_ACT",
    "COM_DISARM_LAND",
    "COM_DISARM_PRFLT",
    "COM_KILL_DISARM",
    "COM_RC_IN_MODE",
)
_NO_PILOT = 4  # COM_RC_IN_MODE: what comes from a radio control is ignored


def heard_setpoint(state: CommanderState) -> CommanderState:
    """A set-point has arrived."""
    return state._replace(setpoint_age_s=0.0)


def step(
    state: CommanderState, now: Situation, dt: float, px4: Parameters, p: Commander
) -> tuple[CommanderState, tuple[str, ...]]:
    """`dt` later: the state, and what the autopilot says about the change."""
    state = _aged(state, now, dt, px4)
    if not state.armed:
        return state, ()
    if state.killed and state.killed_s >= px4["COM_KILL_DISARM"]:
        return _disarmed(state), ("Disarmed by kill-switch",)
    checked = _disarmed_by_time(_watched(state, now, px4, p), now, px4)
    if state.armed and not checked.armed:
        return checked, ("Disarmed by landing" if state.has_flown else "Disarmed by auto preflight disarming",)
    if checked.failsafe is not state.failsafe and checked.failsafe is not Failsafe.NONE:
        return checked, (f"Failsafe activated: {checked.mode.value}",)
    return checked, ()


def _aged(state: CommanderState, now: Situation, dt: float, px4: Parameters) -> CommanderState:
    age = state.setpoint_age_s + dt
    return state._replace(
        setpoint_age_s=age,
        stream_s=state.stream_s + dt if age < px4["COM_OF_LOSS_T"] else 0.0,
        armed_s=state.armed_s + dt if state.armed else 0.0,
        killed_s=state.killed_s + dt if state.killed else 0.0,
        landed_s=state.landed_s + dt if now.landed and state.failsafe is not Failsafe.SINK else 0.0,
        has_flown=state.armed and (state.has_flown or not now.landed),
        until_check_s=state.until_check_s - dt,
    )


def _watched(state: CommanderState, now: Situation, px4: Parameters, p: Commander) -> CommanderState:
    """The periodic check for lost positions and set-points, and for a stream that is back."""
    if state.until_check_s > 0.0:
        return state
    state = state._replace(until_check_s=p.check_period_s)
    if not now.has_position and not now.landed:
        return state._replace(failsafe=Failsafe.BLIND)
    if state.failsafe in (Failsafe.SINK, Failsafe.HOLD) and _streams(state, p):
        return state._replace(failsafe=Failsafe.NONE)
    lost = state.setpoint_age_s > px4["COM_OF_LOSS_T"] + p.loss_latency_s
    if state.mode is Mode.OFFBOARD and lost:
        return state._replace(failsafe=_on_offboard_loss(state, px4))
    return state


def _on_offboard_loss(state: CommanderState, px4: Parameters) -> Failsafe:
    action = _ON_OFFBOARD_LOSS.get(int(px4["COM_OBL_RC_ACT"]), Failsafe.LAND)
    return Failsafe.LAND if action is Failsafe.HOLD and not state.has_origin else action


def _disarmed_by_time(state: CommanderState, now: Situation, px4: Parameters) -> CommanderState:
    if state.has_flown:
        waited = state.landed_s >= px4["COM_DISARM_LAND"]
    else:
        waited = now.landed and state.armed_s >= px4["COM_DISARM_PRFLT"]
    return _disarmed(state) if waited else state


def _disarmed(state: CommanderState) -> CommanderState:
    """A failsafe ends with the flight, and the intended mode shows again: offboard, but it needs a new arm command."""
    return state._replace(armed=False, has_flown=False, failsafe=Failsafe.NONE)


def _streams(state: CommanderState, p: Commander) -> bool:
    return state.stream_s >= p.proof_of_life_s


def answer(
    state: CommanderState, request: Request, now: Situation, px4: Parameters, p: Commander
) -> tuple[CommanderState, Ack]:
    """The state after a request, and the answer to it. Parameters are not the commander's: see autopilot.py."""
    match request:
        case Arm(armed=True):
            return _arm(state, now, p)
        case Arm(force=force):
            if not (force or now.landed):
                return state, Ack.DENIED
            return _disarmed(state), Ack.ACCEPTED
        case Switch(mode=mode):
            return _switch(state, mode, now, p)
        case Terminate():
            return state._replace(terminated=True), Ack.ACCEPTED
        case KillSwitch(on=on):
            return state._replace(killed=on and px4["COM_RC_IN_MODE"] != _NO_PILOT), Ack.ACCEPTED
        case SetOrigin():
            return state._replace(has_origin=True), Ack.ACCEPTED
        case _:
            return state, Ack.UNSUPPORTED


def _arm(state: CommanderState, now: Situation, p: Commander) -> tuple[CommanderState, Ack]:
    if state.armed:
        return state, Ack.ACCEPTED
    if state.stopped or not _can_fly(state, state.intention, now, p) or state.intention is Mode.LAND:
        return state, Ack.DENIED
    return state._replace(armed=True, armed_s=0.0), Ack.ACCEPTED


def _switch(state: CommanderState, mode: Mode, now: Situation, p: Commander) -> tuple[CommanderState, Ack]:
    if state.armed and not _can_fly(state, mode, now, p):
        return state, Ack.TEMPORARILY_REJECTED
    return state._replace(intention=mode, failsafe=Failsafe.NONE), Ack.ACCEPTED


def _can_fly(state: CommanderState, mode: Mode, now: Situation, p: Commander) -> bool:
    if mode is Mode.OFFBOARD:
        return now.has_position and _streams(state, p)
    return now.has_position and (state.has_origin or mode is not Mode.HOLD)
