"""Messages that are lost, frozen, late, doubled, swapped or garbled on the bus, while the person is guided."""

import itertools
from collections.abc import Callable, Iterator
from typing import Any

from schemas.topics import CABLE_FORCE, GUIDANCE, HANDLE_STATE, SAFETY_STATE, VEHICLE_STATE, Topic
from services.faults.fault import Fault, Group, Reaction
from services.faults.rows.common import Act
from services.rehearsal import meddled_bus as bus
from services.rehearsal.chain import Stage

TOPICS: tuple[Topic[Any], ...] = (HANDLE_STATE, CABLE_FORCE, VEHICLE_STATE, GUIDANCE, SAFETY_STATE)
WAYS: dict[str, tuple[str, Callable[[], bus.Meddle]]] = {
    "dropped": ("do not arrive", lambda: bus.dropped),
    "frozen": ("stay the same under new headers", bus.frozen),
    "late": ("arrive 0.5 s late", lambda: bus.delayed(0.5)),
    "doubled": ("arrive twice", lambda: bus.doubled),
    "swapped": ("arrive in the wrong order", bus.swapped),
    "nan": ("have a NaN", lambda: bus.vectors(bus.not_a_number)),
    "thousandfold": ("are in milli-units", lambda: bus.vectors(bus.thousandfold)),
    "ned": ("are in the autopilot's frame", lambda: bus.vectors(bus.north_east_down)),
}
HARMLESS = ("doubled", "swapped")


def messages() -> Iterator[Fault]:
    """Each topic that matters, in each way."""
    for topic, (way, (text, meddle)) in itertools.product(TOPICS, WAYS.items()):
        reaction, within_s = _garbled(topic, way)
        name = f"{topic.key.split('/')[0]}_{way}"
        about = f"messages of {topic.key} {text}"
        yield Fault(
            name,
            Group.BUS,
            about,
            reaction,
            within_s,
            _meddled(topic.key, meddle),
            watch_s=5.0,
            family=f"{topic.key} {'in disorder' if way in HARMLESS else 'wrong'}",
        )

    yield Fault("force_flown_late", Group.BUS, "messages of force/cable arrive 0.08 s late: all loops share a processor with others",
                Reaction.EASE, 0.6, _meddled(CABLE_FORCE.key, lambda: bus.delayed(0.08)), watch_s=6.0)  # fmt: skip


def _garbled(topic: Topic[Any], way: str) -> tuple[Reaction, float]:
    """What it must lead to, by when."""
    if way in HARMLESS:
        return Reaction.NOTHING, 0.0
    if topic is HANDLE_STATE and way in ("thousandfold", "ned"):  # that far off nobody holds it
        return Reaction.LET_GO, 0.4
    if topic is SAFETY_STATE and way in ("frozen", "thousandfold", "ned"):  # its vectors matter only in position mode
        return Reaction.ANY, 0.0
    if topic is VEHICLE_STATE and way in ("dropped", "late", "nan"):
        return Reaction.EASE, 0.5
    return Reaction.EASE, 0.4


def _meddled(key: str, meddle: Callable[[], bus.Meddle]) -> Act:
    def act(stage: Stage) -> None:
        stage.bus.meddle[key] = meddle()

    return act
