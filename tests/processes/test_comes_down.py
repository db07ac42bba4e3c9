"""What ends the flight: a bridge that is gone, a supervisor that is gone for long or begins anew, a vehicle that nobody sees.

Where the autopilot lands by itself its mode is read off the simulated vehicle's fall: nobody is left who could tell it.
"""

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

import pytest

from schemas.safety import Action, Level, Phase
from schemas.topics import SAFETY_STATE, SETPOINT
from tests.processes import promises
from tests.processes.deeds import Do, killed, leaked, restarted, spun, stopped
from tests.processes.system import System, fly
from tests.processes.window import NEVER, Window


@asynccontextmanager
async def broken_in_the_walk(system: System, name: str, deed: Do) -> AsyncGenerator[Window]:
    """While the person is pulled along: the deed, and what follows; `done_s` is when it was done."""
    await system.guided()
    async with system.broken(name) as window:
        await deed(system, name)
        window.done_s = window.age_s
        yield window
    promises.assert_pulled(window)


@pytest.mark.parametrize(
    ("phase", "deed"),
    [
        pytest.param(Phase.TAKEOFF, stopped(5.0), id="stopped for 5 s in takeoff"),
        pytest.param(Phase.ZEROING, spun(5.0), id="spins for 5 s in zeroing"),
        pytest.param(Phase.READY, killed, id="killed in ready"),
    ],
)
def test_without_the_bridge_the_autopilot_lands(tmp_path, phase, deed):
    async def script(system: System) -> None:
        await system.reach(phase)
        await asyncio.sleep(1.0)
        async with system.broken("px4_bridge") as window:
            await deed(system, "px4_bridge")
            await system.landed()
            await asyncio.sleep(1.0)
        promises.assert_left_to_the_autopilot(window)
        assert Level.DESCEND in window.levels(), window
        if deed is not killed:
            await system.put_down()

    fly(tmp_path, script)


def test_a_bridge_that_was_away_for_long_leaves_the_landing_to_the_autopilot(tmp_path):
    """After two absences that the autopilot bridges."""

    async def script(system: System) -> None:
        await system.reach(Phase.GUIDING)
        for short in (stopped(0.3), spun(0.3)):
            await system.pulled()
            async with system.broken("px4_bridge") as window:
                await short(system, "px4_bridge")
                await asyncio.sleep(1.0)
            promises.assert_pulled(window)
            promises.assert_backs_off(window, 0.35)
        await system.pulled()
        async with system.broken("px4_bridge") as window:
            await stopped(1.0)(system, "px4_bridge")
            await system.put_down()
        promises.assert_pulled(window)
        promises.assert_left_to_the_autopilot(window)
        promises.assert_force(window)

    fly(tmp_path, script)


def test_a_bridge_that_begins_anew_does_not_take_the_vehicle_back(tmp_path):
    async def script(system: System) -> None:
        async with broken_in_the_walk(system, "px4_bridge", restarted) as window:
            await system.put_down()
            await asyncio.sleep(2.0)
        promises.assert_silent(window)
        assert system.disarmed
        assert Level.DESCEND in window.levels(), window

    fly(tmp_path, script)


def test_supervisor_and_bridge_dead(tmp_path):
    """Both of their own leaks, one after the other; nobody obeys a kill any more, and the command says so."""

    async def script(system: System) -> None:
        async with broken_in_the_walk(system, "safety_supervisor", leaked) as window:
            await asyncio.sleep(1.0)
        promises.assert_backs_off(window, window.done_s + 0.3)
        async with system.broken("px4_bridge") as window:
            await leaked(system, "px4_bridge")
            gone_s = window.age_s
            code, told = await system.clew("kill")
            await system.landed()
        assert window.silent_s() < gone_s + promises.SILENT_S, window
        assert window.sinks_s() < gone_s + promises.LOST_S + promises.SINK_S + window.waited_s(gone_s + 2.0), window
        assert code == 1
        assert "NOT OBEYED. Use the radio control's kill switch" in told

    fly(tmp_path, script)


def test_without_the_supervisor_a_person_can_still_stop_the_motors(tmp_path):
    async def script(system: System) -> None:
        async with broken_in_the_walk(system, "safety_supervisor", killed) as window:
            await asyncio.sleep(1.5)
        promises.assert_backs_off(window, 0.3)  # before it falls, which snatches at the hand
        code, told = await system.clew("kill")
        await system.landed()
        assert (code, system.disarmed) == (0, True), told

    fly(tmp_path, script)


def test_a_supervisor_that_begins_in_flight_holds_until_a_person_resumes_and_then_lands(tmp_path):
    """Within 3 s; a slow host needs longer for a start, and then the bridge has begun to land."""

    async def script(system: System) -> None:
        async with broken_in_the_walk(system, "safety_supervisor", restarted) as window:
            await system.until(lambda: Phase.HOLD in window.phases(), "held")
            await asyncio.sleep(1.0)
            promises.assert_backs_off(window, 0.3)
            assert any("the supervisor began in flight" in reason for reason in window.reasons()), window
            landing = window.lands_s() < NEVER
            if not landing:
                await system.until_accepted(Action.RESUME)
            await system.put_down()
        assert Phase.GUIDING not in window.phases()[1:], window
        assert (Phase.CLEARING in window.phases()) is not landing, window

    fly(tmp_path, script)


def test_a_tracker_that_begins_anew_is_believed_if_it_comes_in_time(tmp_path):
    """Within 2.5 s; a slow host needs longer for a start, and then the flight is over."""

    async def script(system: System) -> None:
        async with broken_in_the_walk(system, "tracker", restarted) as window:
            await system.until(lambda: system.pulls or system.phase is Phase.LANDED, "pulled again, or landed")
        promises.assert_backs_off(window, 0.3)
        resumed = [t for t, m in window.all(SETPOINT, window.backs_off_s()) if m.kind.value == "admittance"]
        descended = [t for t, m in window.all(SAFETY_STATE) if m.level is Level.DESCEND]
        assert bool(resumed) is not bool(descended), window

    fly(tmp_path, script)
