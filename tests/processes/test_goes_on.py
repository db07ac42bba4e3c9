"""What a system recovers from: one flight for each service, in which it falls ill in one way after the other.

Between two of them the person is pulled along again. Where that does not come, the flight is over: the verdict of all that
should have followed says so.
"""

import asyncio
import os
import resource
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from schemas.safety import Level, Phase
from schemas.topics import HEALTH
from tests.processes import promises
from tests.processes.deeds import Do, killed, leaked, restarted, spun, stopped
from tests.processes.system import System, fly
from tests.processes.window import Flown, Window

AFTER_S = 1.0


async def disk_full(system: System, name: str) -> None:
    """No file may be larger than this one is now; the recorder has nothing else to write."""
    full = os.stat(f"{system.config.session_dir}/session.mcap").st_size
    resource.prlimit(system.pid(name), resource.RLIMIT_FSIZE, (full, full))
    health = system.heard[HEALTH[name].key]
    await system.until(lambda: "STOPPED: the file cannot be written" in health[-1].status, "told that the disk is full")


async def recorded_anew(system: System, name: str) -> None:
    """Killed, and started again into a file of its own: none is ever overwritten."""
    file = Path(system.config.session_dir, "session.mcap")
    await killed(system, name)
    os.rename(file, file.with_name("killed.mcap"))
    await system.start_again(name)
    await system.until(file.exists, "recorded anew")


ILLS: dict[str, Do] = {
    "stopped for 0.3 s": stopped(0.3),
    "spins for 0.3 s": spun(0.3),
    "stopped for 1 s": stopped(1.0),
    "spins for 1 s": spun(1.0),
    "stopped for 5 s": stopped(5.0),
    "restarted": restarted,
    "killed, and another started": recorded_anew,
    "leaks": leaked,
    "disk full": disk_full,
}
SHORT, MIDDLE, LONG = tuple(ILLS)[:2], tuple(ILLS)[2:4], ("stopped for 5 s",)
LEADS_TO = {("tracker", *LONG): Level.DESCEND, ("safety_supervisor", *LONG): Level.DESCEND}
"""What is graver than to back off, and ends the flight: the autopilot flies blindly, or the bridge lands."""
WITHIN_S = {"force_estimator": 0.2, "guiding_controller": 0.2, "tracker": 0.3, "safety_supervisor": 0.3}
"""As the campaign on virtual time promises; the supervisor's own age is judged by the bridge."""
FLIGHTS = {
    "guiding_controller": (*SHORT, *MIDDLE, *LONG, "restarted", "leaks"),
    "force_estimator": (*SHORT, *MIDDLE, *LONG, "restarted", "leaks"),
    "tracker": (*SHORT, *MIDDLE, *LONG),
    "safety_supervisor": (*SHORT, *MIDDLE, *LONG),
    "recorder": (*MIDDLE, *LONG, "disk full", "killed, and another started"),
}
BRIDGED = {("tracker", ill) for ill in SHORT}
"""As long as what may be missed of the handle, to a frame: backed off from, or not."""


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Flown[Window]]:
    """The flight of a service, on the first question about it."""

    @cache
    def flight(name: str) -> Flown[Window]:
        so_far = Flown[Window]()
        with so_far.tried():
            fly(tmp_path_factory.mktemp("on"), lambda system: _script(system, name, so_far.windows))
        return so_far

    return flight


async def _script(system: System, name: str, windows: dict[str, Window]) -> None:
    await system.reach(Phase.GUIDING)
    for ill in FLIGHTS[name]:
        await system.pulled()
        async with system.broken(name) as window:
            await ILLS[ill](system, name)
            window.done_s = window.age_s
            await (system.put_down() if (name, ill) in LEADS_TO else asyncio.sleep(AFTER_S))
        windows[ill] = window


@pytest.mark.parametrize(("name", "ill"), [(name, ill) for name, ills in FLIGHTS.items() for ill in ills])
def test_it(flown, name, ill):
    window = flown(name)[ill]
    promises.assert_pulled(window)
    promises.assert_force(window)
    if name == "recorder":
        promises.assert_unnoticed(window)
    elif (name, ill) in BRIDGED:
        assert max(window.levels()) <= Level.EASE, window
    else:
        begins_s = window.done_s if ill == "leaks" else 0.0
        promises.assert_backs_off(window, begins_s + WITHIN_S[name])
        assert max(window.levels()) == LEADS_TO.get((name, ill), Level.EASE), window
