"""The autopilot refuses, is flown by somebody else, runs out of battery, or is out of reach."""

from collections.abc import Iterator
from dataclasses import replace

from schemas.safety import Phase
from services.config import Config, load
from services.faults.fault import Fault, Group, Moment, OnPx4, Reaction
from services.faults.rows.common import FALLS, MOMENTS, SINKS, Act, later
from services.rehearsal.chain import Stage
from services.simulator.commander import Arm, KillSwitch, Mode, Request, SetParameter, Switch

FULL = OnPx4(not_flown="PX4's simulated battery is full while it is disarmed, as it is then")
FILTERED = OnPx4(late_s=3.0, late="PX4 filters the voltage over a second, so it shows a sudden fall 3 s late")


def vehicles() -> Iterator[Fault]:
    """The rows of this module."""
    V = Group.VEHICLE
    before_arming = Moment(Phase.TAKEOFF, 0.0)
    yield Fault(
        "offboard_refused",
        V,
        "the autopilot refuses offboard mode",
        Reaction.STAYS_DOWN,
        0.0,
        _refuses(Switch),
        before_arming,
        6.0,
        on_px4=OnPx4(not_flown="on the ground PX4 takes offboard mode from anybody"),
    )
    yield Fault(
        "arming_denied", V, "the autopilot refuses to arm", Reaction.STAYS_DOWN, 0.0, _refuses(Arm), before_arming, 6.0
    )
    yield Fault(
        "pilot_takes_over",
        V,
        "a pilot switches to Hold",
        Reaction.HANDS_OFF,
        0.2,
        _pilot(Mode.HOLD),
        exempt={"calm": "the pilot flies, stiffly"},
    )
    yield Fault("pilot_lands", V, "a pilot switches to Land", Reaction.LAND, 0.1, _pilot(Mode.LAND), watch_s=12.0,
                exempt=SINKS)  # fmt: skip
    yield Fault("pilot_kills", V, "a pilot moves the kill switch at the radio control", Reaction.DISARMED, 0.2, _kill_switch,
                watch_s=8.0, world=heeds_a_pilot, exempt=FALLS)  # fmt: skip
    for moment in (m for m in MOMENTS if m.phase is not Phase.LANDING):
        name = f"battery_empty_in_{moment.phase}"
        yield Fault(
            name,
            V,
            f"the battery falls to 10 % in {moment.phase}",
            Reaction.LAND,
            3.5,
            _battery(10),
            moment,
            7.0,
            family="battery empty",
            on_px4=FULL if moment.phase is Phase.TAKEOFF else FILTERED,
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


def _refuses(request: type[Request]) -> Act:
    return lambda stage: stage.flight.vehicle.refuse(request)


def _pilot(mode: Mode) -> Act:
    return lambda stage: stage.flight.vehicle.pilot(Switch(mode))


def _kill_switch(stage: Stage) -> None:
    stage.flight.vehicle.pilot(KillSwitch(True))


def heeds_a_pilot(config: Config, **otherwise: int | float) -> Config:
    """With a pilot at a radio control, and the autopilot set as on hardware, or `otherwise`."""
    px4 = load("drone").px4_bridge.px4 | otherwise
    simulator, sitl = config.simulator, config.simulator.px4_sitl
    simulator = replace(
        simulator,
        autopilot=replace(simulator.autopilot, px4=px4),
        px4_sitl=replace(sitl, radio_control=True) if sitl else None,
    )
    return config.model_copy(update={"px4_bridge": replace(config.px4_bridge, px4=px4), "simulator": simulator})


def _battery(percent: int) -> Act:
    return lambda stage: stage.flight.vehicle.drain(percent)


def _cut(stage: Stage) -> None:
    stage.flight.vehicle.cut = True


def _blink(stage: Stage) -> None:
    stage.flight.vehicle.pilot(SetParameter("COM_OBL_RC_ACT", 0))
    stage.flight.vehicle.cut = True
    later(1.5, lambda: setattr(stage.flight.vehicle, "cut", False))
