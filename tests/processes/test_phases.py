"""Faults of the campaign on virtual time, done to real processes in the phases round the walk: what they lead to is said there.

Three flights, in each of which something falls ill in one phase after the other; what ends the flight comes last. After that
the vehicle is on the floor, with the motors off.
"""

import asyncio
from collections.abc import Callable
from functools import cache

import pytest

from schemas.safety import Action, Phase
from schemas.topics import SAFETY_STATE
from services.config import Config, load
from services.faults import catalogue
from services.faults.fault import Fault
from services.rehearsal.quick import SHORT_PATH
from tests.processes import promises
from tests.processes.deeds import Do, killed, leaked, stopped
from tests.processes.system import System, fly
from tests.processes.window import Flown, Window

AFTER_S = 1.5
DEEDS: dict[str, Do] = {"stop 1 s": stopped(1.0), "kill": killed, "leak": leaked}
FLIGHTS: dict[str, tuple[tuple[Phase, str, str], ...]] = {
    "without guidance": (
        (Phase.TAKEOFF, "tracker", "stop 1 s"),
        (Phase.ZEROING, "safety_supervisor", "stop 1 s"),
        (Phase.READY, "force_estimator", "stop 1 s"),
        (Phase.GUIDING, "guiding_controller", "kill"),
        (Phase.CLEARING, "safety_supervisor", "kill"),
    ),
    "without a force": (
        (Phase.READY, "safety_supervisor", "stop 1 s"),
        (Phase.GUIDING, "force_estimator", "kill"),
        (Phase.CLEARING, "tracker", "leak"),
    ),
    "to its end": (
        (Phase.ARRIVED, "tracker", "stop 1 s"),
        (Phase.CLEARING, "force_estimator", "stop 1 s"),
        (Phase.LANDING, "px4_bridge", "kill"),
    ),
}
ALL = [(flight, *step) for flight, steps in FLIGHTS.items() for step in steps]


def fault(phase: Phase, name: str, deed: str) -> Fault:
    """The same on virtual time; who leaks until it ends is killed."""
    known = f"stop_{name}_1s_in_{phase}" if deed == "stop 1 s" else f"kill_{name}_in_{phase}"
    found = catalogue.named(known)
    assert found, f"the campaign has no {known}"
    return found


def short(config: Config) -> Config:
    """A path that is soon walked, and the demo's own person, who lets go at its end."""
    return config.model_copy(update={"path": SHORT_PATH, "person": load("demo").person})


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Flown[Window]]:
    """A flight, on the first question about it."""

    @cache
    def flight(name: str) -> Flown[Window]:
        so_far = Flown[Window]()
        with so_far.tried():
            fly(tmp_path_factory.mktemp("phases"), lambda system: _script(system, name, so_far.windows), short)
        return so_far

    return flight


async def _script(system: System, flight: str, windows: dict[object, Window]) -> None:
    *_, last = FLIGHTS[flight]
    for step in FLIGHTS[flight]:
        phase, name, deed = step
        await system.reach(phase)
        await asyncio.sleep(fault(*step).moment.after_s)
        async with system.broken(name) as window:
            await DEEDS[deed](system, name)
            window.done_s = window.age_s
            await (_put_down(system, name) if step is last else asyncio.sleep(AFTER_S))
        windows[step] = window
        if phase is Phase.GUIDING and deed == "kill":
            await system.until_accepted(Action.LAND)


async def _put_down(system: System, dead: str) -> None:
    """Whether or not a supervisor is left to say so; without the bridge nobody is left to say that it is disarmed."""
    await system.landed()
    if dead == "px4_bridge":
        await asyncio.sleep(1.0)
    else:
        await system.until(lambda: system.disarmed, "disarmed")


@pytest.mark.parametrize(("flight", "phase", "name", "deed"), ALL)
def test_it(flown: Callable[[str], Flown[Window]], flight: str, phase: Phase, name: str, deed: str):
    window, promised = flown(flight)[phase, name, deed], fault(phase, name, deed)
    *_, (_, before) = window.all(SAFETY_STATE, -1.0, 0.0)
    assert before.phase is phase, window
    promises.assert_reaction(window, promised, window.done_s if deed == "leak" else 0.0)
