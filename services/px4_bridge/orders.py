"""What the autopilot is to be asked for now: offboard, arming, landing. A pure decision; acknowledged is not flying.

Only the take-off phase may arm: a vehicle that has disarmed itself in flight or after landing stays so. The order to stop
the motors is no step of this ladder: it waits for no other answer and is repeated until the vehicle is seen disarmed.
"""

from enum import Enum

from schemas.safety import Permit, Phase
from schemas.vehicle import FlightMode

AWAY_S = 0.7  # PX4 leaves offboard 0.73 to 0.89 s after the last set-point (COM_OF_LOSS_T = 0.5)
SILENCE_S = 0.1  # how long after the loop that made it a set-point may leave
FORGOTTEN_S = 3.0  # an autopilot that lands as it should disarms by itself before
STREAM_FIRST_S = 0.5  # the autopilot refuses offboard without a running stream


class Order(Enum):
    """One request to the autopilot."""

    NOTHING = "nothing"
    OFFBOARD = "offboard"
    ARM = "arm"
    LAND = "land"


def next_order(permit: Permit, phase: Phase, armed: bool, mode: FlightMode, streaming_s: float) -> Order:
    """The next step from here to what the permit wants."""
    if permit is Permit.LAND:
        return Order.LAND if armed and mode not in (FlightMode.LAND, FlightMode.DESCEND) else Order.NOTHING
    if permit is not Permit.POSITION or phase is not Phase.TAKEOFF or streaming_s < STREAM_FIRST_S:
        return Order.NOTHING
    if mode is not FlightMode.OFFBOARD:
        return Order.OFFBOARD
    return Order.NOTHING if armed else Order.ARM


def kills(permit: Permit, armed: bool) -> bool:
    """Whether the motors are to be stopped at once, in whatever phase and mode."""
    return permit is Permit.KILL and armed


def forgotten(phase: Phase, armed: bool, in_air: bool) -> bool:
    """Whether it stands on the ground with the motors armed and no take-off under way."""
    return armed and not in_air and phase is not Phase.TAKEOFF


class Flown(Enum):
    """What has become of the flight by set-points."""

    NOT_YET = "not yet"
    OFFBOARD = "offboard"
    LEFT = "left"
    """The autopilot goes its own way, or did when this bridge began; it would take new set-points up without being asked."""


def flown(before: Flown, permit: Permit, phase: Phase, armed: bool, mode: FlightMode, silent_s: float) -> Flown:
    """The same one tick later, `silent_s` after the last set-point. Only a new take-off, disarmed, forgets that it has left.

    Who was away for so long that the autopilot leaves is not told yet that it did: of what it said meanwhile the oldest is
    read first.
    """
    if not armed and permit is Permit.POSITION and phase is Phase.TAKEOFF:
        return Flown.NOT_YET
    if before is Flown.NOT_YET and armed and mode is FlightMode.OFFBOARD:
        return Flown.OFFBOARD
    left = mode is not FlightMode.OFFBOARD or silent_s > AWAY_S
    return Flown.LEFT if before is Flown.OFFBOARD and left else before


def streams(permit: Permit, phase: Phase, armed: bool, mode: FlightMode, so_far: Flown = Flown.NOT_YET) -> bool:
    """Whether set-points may leave: never without a permit, and no longer once the autopilot flies or lands by itself.

    PX4 shows offboard again for a moment when it has landed and disarms: the mode alone does not tell.
    """
    if so_far is Flown.LEFT or permit is Permit.KILL:
        return False
    if not armed:
        return permit is Permit.POSITION and phase is Phase.TAKEOFF
    return permit is not Permit.NONE and mode not in (FlightMode.LAND, FlightMode.DESCEND)
