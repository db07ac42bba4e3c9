"""What a person may do. It counts from the moment in which they hold the handle."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from schemas.safety import Phase
from services.config import Config
from services.faults.fault import GUIDING, Fault, Group, Moment, OnPx4, Reaction
from services.faults.rows.common import later
from services.rehearsal.chain import Stage
from services.simulator.human import Event, Kind

TOLD = Moment(Phase.READY, 0.0)
"""The person has just been told to take the handle."""
DEED_S = 7.0
"""A moment after the other faults of the guided walk begin."""
CAUGHT_M, WINDS_S, TURNS = 0.2, 1.0, 100
RUNS = dict.fromkeys(("tip_hand", "tip_head", "calm"), "the person runs faster than the vehicle may fly")
DRAGS = dict.fromkeys(("tip_head", "calm"), "the hand drags the vehicle down beside a head that stays where it was")

FOLLOWS = {
    "tip_hand": "the hand comes up again under the vehicle, and PX4 climbs away from it a little later than the stand-in"
}


def people() -> Iterator[Fault]:
    """The rows of this module."""

    def deed(name: str, about: str, reaction: Reaction, within_s: float, watch_s: float = 6.0, **event: Any) -> Fault:
        exempt: dict[str, str] = event.pop("exempt", {})
        on_px4: OnPx4 = event.pop("on_px4", OnPx4())
        deeds = (Event(start_s=DEED_S, **event),)
        return Fault(
            name,
            Group.PERSON,
            about,
            reaction,
            within_s,
            moment=GUIDING,
            watch_s=watch_s,
            deeds=deeds,
            exempt=exempt,
            on_px4=on_px4,
        )

    yield deed("lets_go", "the person opens the hand", Reaction.LET_GO, 0.4, kind=Kind.LET_GO)
    yield deed(
        "stops_30s", "the person stands still for 30 s", Reaction.ANY, 0.0, 31.0, kind=Kind.STOP, duration_s=30.0
    )
    yield deed(
        "runs_ahead",
        "the person runs ahead: 20 N forward for 2 s",
        Reaction.ANY,
        0.0,
        kind=Kind.PUSH,
        duration_s=2.0,
        force_W_N=(20.0, 0.0, 0.0),
        exempt=RUNS,
    )
    yield deed(
        "runs_back",
        "the person runs back: 20 N for 2 s",
        Reaction.ANY,
        0.0,
        kind=Kind.PUSH,
        duration_s=2.0,
        force_W_N=(-20.0, 0.0, 0.0),
        exempt=RUNS,
    )
    yield deed(
        "falls",
        "the person falls: the hand drops by 0.8 m at 2 m/s",
        Reaction.LET_GO,
        0.5,
        kind=Kind.RAISE,
        rise_m=-0.8,
        speed_mps=2.0,
        exempt=DRAGS,
    )
    yield deed(
        "pulls_down",
        "the person pulls the hand down by 0.6 m at 1 m/s",
        Reaction.LET_GO,
        0.6,
        kind=Kind.RAISE,
        rise_m=-0.6,
        speed_mps=1.0,
        exempt=DRAGS,
    )
    yield deed(
        "pulls_down_with_15_newtons",
        "the person pulls down with 15 N, by as much as the arm gives: 0.6 m",
        Reaction.LET_GO,
        0.6,
        kind=Kind.PULL_DOWN,
        duration_s=2.0,
        force_W_N=(0.0, 0.0, -15.0),
        rise_m=-0.6,
        exempt=DRAGS,
        on_px4=OnPx4(exempt=FOLLOWS),
    )
    yield deed(
        "lifts_the_hand",
        "the hand rises by 0.7 m at 0.7 m/s",
        Reaction.ANY,
        0.0,
        kind=Kind.RAISE,
        rise_m=0.7,
        speed_mps=0.7,
    )
    yield replace(
        deed("lifts_the_hand_at_the_start", "the hand rises by 0.7 m at 0.7 m/s under the vehicle", Reaction.ANY, 0.0, kind=Kind.RAISE, rise_m=0.7, speed_mps=0.7),
        moment=TOLD,
        deeds=(Event(start_s=1.2, kind=Kind.RAISE, rise_m=0.7, speed_mps=0.7),),
    )  # fmt: skip
    yield Fault(
        "tangled",
        Group.PERSON,
        "the cable is 0.2 m shorter than believed",
        Reaction.LAND,
        1.5,
        moment=Moment(Phase.ZEROING, 0.0),
        watch_s=25.0,
        world=_shorter,
    )
    yield Fault(
        "tangled_before_it_is_taken",
        Group.PERSON,
        "the cable is caught with nobody at the handle: 0.2 m shorter within 1 s",
        Reaction.LAND,
        1.5,
        _winds,
        TOLD,
        watch_s=8.0,
    )
    yield Fault(
        "tangled_in_the_walk",
        Group.PERSON,
        "the cable winds round something: 0.2 m shorter within 1 s",
        Reaction.EASE,
        0.8,
        _winds,
        watch_s=8.0,
        exempt={"calm": "it goes on winding after the vehicle has backed off"},
    )


def _winds(stage: Stage) -> None:
    for n in range(TURNS):
        later(n * WINDS_S / TURNS, lambda: stage.catch(CAUGHT_M / TURNS))


def _shorter(config: Config) -> Config:
    cable = replace(config.cable, rest_length_m=config.cable.rest_length_m - CAUGHT_M)
    return config.model_copy(update={"cable": cable})
