"""The autopilot refuses, is flown by somebody else, runs out of battery, or is out of reach."""

from collections.abc import Iterator
from typing import Any

from schemas.safety import Phase
from services.faults.fault import Fault, Group, Moment, Reaction
from services.faults.rows.common import MOMENTS, SINKS, Act, later
from services.rehearsal.chain import Stage
from services.rehearsal.direct_vehicle import Messages
from services.simulator.commander import Arm, Mode, SetOrigin, SetParameter, Switch


def vehicles() -> Iterator[Fault]:
    """The rows of this module."""
    V = Group.VEHICLE
    ground = Moment(Phase.IDLE, 0.4)
    yield Fault(
        "offboard_refused",
        V,
        "the autopilot refuses offboard mode",
        Reaction.STAYS_DOWN,
        0.0,
        _refuses(Switch),
        ground,
        6.0,
    )
    yield Fault(
        "arming_denied", V, "the autopilot refuses to arm", Reaction.STAYS_DOWN, 0.0, _refuses(Arm), ground, 6.0
    )
    yield Fault(
        "pilot_takes_over",
        V,
        "a pilot switches to Hold by radio control",
        Reaction.HANDS_OFF,
        0.2,
        _pilot(Mode.HOLD),
        exempt={"calm": "the pilot flies, stiffly"},
    )
    yield Fault("pilot_lands", V, "a pilot switches to Land by radio control", Reaction.LAND, 0.1, _pilot(Mode.LAND), watch_s=12.0,
                exempt=SINKS)  # fmt: skip
    for moment in (m for m in MOMENTS if m.phase is not Phase.LANDING):
        name = f"battery_empty_in_{moment.phase}"
        yield Fault(
            name, V, f"the battery falls to 10 % in {moment.phase}", Reaction.LAND, 3.5, _battery(10), moment, 7.0
        )
    yield Fault("mavlink_cut", V, "the link between bridge and autopilot is cut", Reaction.AUTOPILOT_LANDS, 1.0, _cut, watch_s=12.0,
                exempt=SINKS | {"late": "they do not arrive"})  # fmt: skip
    yield Fault(
        "offboard_again",
        V,
        "with PX4's default action the link is lost for 1.5 s and comes back",
        Reaction.ANY,
        0.0,
        _blink,
        watch_s=12.0,
    )


def _refuses(request: type[Any]) -> Act:
    def act(stage: Stage) -> None:
        stage.flight.vehicle.refuses = (request,)

    return act


def _pilot(mode: Mode) -> Act:
    def act(stage: Stage) -> None:
        stage.flight.vehicle.pilot(SetOrigin())
        stage.flight.vehicle.pilot(Switch(mode))

    return act


def _battery(percent: int) -> Act:
    def act(stage: Stage) -> None:
        def garble(messages: Messages) -> Messages:
            return [
                (name, {**fields, "battery_remaining": percent} if name == "BATTERY_STATUS" else fields)
                for name, fields in messages
            ]

        stage.flight.vehicle.garble = garble

    return act


def _cut(stage: Stage) -> None:
    stage.flight.vehicle.cut = True


def _blink(stage: Stage) -> None:
    stage.flight.vehicle.pilot(SetParameter("COM_OBL_RC_ACT", 0))
    stage.flight.vehicle.cut = True
    later(1.5, lambda: setattr(stage.flight.vehicle, "cut", False))
