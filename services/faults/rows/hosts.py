"""Clocks that jump, of either host, as its stamps show them; and what operators ask for."""

import itertools
from collections.abc import Iterator
from typing import Any

from schemas.safety import Action
from schemas.topics import CABLE_FORCE, GUIDANCE, HANDLE_STATE, SAFETY_STATE, VEHICLE_IMU, VEHICLE_STATE, Topic
from services.faults.fault import Fault, Group, Reaction
from services.faults.rows.common import FALLS, MOMENTS, Act
from services.rehearsal import meddled_bus as bus
from services.rehearsal.chain import Stage

GROUND = (HANDLE_STATE, GUIDANCE, SAFETY_STATE)
DRONE = (VEHICLE_STATE, CABLE_FORCE, VEHICLE_IMU)


def clocks() -> Iterator[Fault]:
    """The stamps of one host jump."""
    for host, by_s in itertools.product(("ground", "drone"), (1.0, -1.0, 3600.0, -3600.0)):
        topics = GROUND if host == "ground" else DRONE
        name = f"clock_of_{host}_{'plus' if by_s > 0 else 'minus'}_{abs(by_s):g}s"
        about = f"the stamps of the {host}'s host jump by {by_s:+g} s"
        yield Fault(
            name,
            Group.CLOCK,
            about,
            Reaction.EASE,
            0.3,
            _jumped(topics, by_s),
            watch_s=5.0,
            family=f"clock of the {host}'s host jumps",
        )


def _jumped(topics: tuple[Topic[Any], ...], by_s: float) -> Act:
    def act(stage: Stage) -> None:
        for topic in topics:
            stage.bus.meddle[topic.key] = bus.shifted(by_s)

    return act


def operators() -> Iterator[Fault]:
    """Each command, and the motors stopped from every phase."""
    yield Fault("clew_stop", Group.OPERATOR, "an operator stops it", Reaction.EASE, 0.15, _asks(Action.EASE))
    yield Fault("clew_hold", Group.OPERATOR, "an operator holds it", Reaction.HOLD, 0.15, _asks(Action.HOLD))
    yield Fault(
        "clew_land", Group.OPERATOR, "an operator lands it", Reaction.LAND, 0.15, _asks(Action.LAND), watch_s=25.0
    )
    for moment in MOMENTS:
        name = f"clew_kill_in_{moment.phase}"
        yield Fault(name, Group.OPERATOR, f"an operator stops the motors in {moment.phase}", Reaction.DISARMED, 0.2, _asks(Action.KILL), moment, 3.0, family="clew kill",
                    exempt=FALLS)  # fmt: skip
    yield Fault("clew_kill_without_supervisor", Group.OPERATOR, "an operator stops the motors, the supervisor dead", Reaction.DISARMED, 0.2, _kill_alone, watch_s=3.0,
                exempt=FALLS)  # fmt: skip


def _asks(action: Action) -> Act:
    return lambda stage: stage.ask(action, 7)


def _kill_alone(stage: Stage) -> None:
    stage.kill("safety_supervisor")
    stage.ask(Action.KILL, 7)
