"""A pilot at a radio control beside real PX4 in software: what their kill switch does, and when nothing. Needs PX4_BIN."""

import asyncio

import pytest

from schemas.safety import Phase
from schemas.topics import SAFETY_STATE, TRUTH, VEHICLE_STATE
from schemas.vehicle import FlightMode
from services.faults.rows.vehicles import heeds_a_pilot
from services.rehearsal import px4_flight
from services.rehearsal.chain import Flight, Script, Stage
from services.rehearsal.quick import quicker
from services.simulator.commander import KillSwitch
from tests.services import px4_chain

pytestmark = [
    pytest.mark.skipif(not px4_chain.PX4_BIN, reason="PX4_BIN is not set: no real PX4 to fly"),
    pytest.mark.timeout(300),
]
DOWN_M = 0.15


def walking(folder, script: Script, **otherwise: float) -> Flight:
    """Set as on hardware, or `otherwise`, with the radio control on from before the start; `script` begins 1 s into the walk."""

    async def in_the_walk(stage: Stage) -> None:
        await px4_flight.started(stage)
        await stage.until(lambda state: state.phase is Phase.GUIDING, 60.0)
        await asyncio.sleep(1.0)
        await script(stage)

    config = quicker(px4_chain.px4_config(folder))
    return px4_flight.fly(config, in_the_walk, configs={"simulator": heeds_a_pilot(config, **otherwise)})


def height_m(stage: Stage) -> float:
    return stage.flight.said[TRUTH.key][-1].robot_position_m.z


def flies_on(stage: Stage, since_s: float) -> bool:
    """In offboard, armed, guiding, at height: nothing has happened since."""
    said = stage.flight.said
    robots = [m for m in said[VEHICLE_STATE.key] if m.stamp_ns * 1e-9 > since_s]
    phases = {m.phase for m in said[SAFETY_STATE.key] if m.stamp_ns * 1e-9 > since_s}
    offboard = all(m.armed and m.mode is FlightMode.OFFBOARD for m in robots)
    return bool(robots) and offboard and phases == {Phase.GUIDING} and height_m(stage) > 1.0


def test_with_the_parameter_of_the_simulation_the_switch_does_nothing(tmp_path):
    """So hardware's profile has another, and preflight looks at it."""

    async def script(stage: Stage) -> None:
        begin_s = stage.now_s
        stage.flight.vehicle.pilot(KillSwitch(True))
        await asyncio.sleep(3.0)
        assert flies_on(stage, begin_s)
        assert not stage.flight.vehicle.checks.pilot

    walking(tmp_path, script, COM_RC_IN_MODE=4)


def test_of_a_radio_control_only_the_move_of_its_switch_counts(tmp_path):
    """Sticks do not take over from offboard; one that goes is not missed; one that comes with its switch on is not heeded."""

    async def script(stage: Stage) -> None:
        vehicle, begin_s = stage.flight.vehicle, stage.now_s
        radio = vehicle.radio_control
        assert vehicle.checks.pilot
        radio.sticks = (1.0, -1.0, 1.0, 0.0)
        await asyncio.sleep(0.5)
        radio.sticks = (0.0, 0.0, 0.0, 0.0)
        radio.on = False
        await asyncio.sleep(2.0)
        assert not vehicle.checks.pilot
        radio.kill = radio.on = True
        await asyncio.sleep(2.0)
        assert vehicle.checks.pilot
        radio.kill = False
        await asyncio.sleep(0.5)
        assert flies_on(stage, begin_s)
        radio.kill = True
        await asyncio.sleep(2.0)
        assert not vehicle.sample.armed
        assert vehicle.sample.killed
        assert height_m(stage) < DOWN_M

    walking(tmp_path, script)


@pytest.mark.parametrize(("disarms_s", "flies_again"), [(5.0, True), (0.0, False)], ids=["PX4's default", "ours"])
def test_by_px4s_default_the_way_back_of_the_switch_starts_the_motors_again(tmp_path, disarms_s, flies_again):
    """A bridge that lives disarms it as soon as it is told of the switch; here it is dead."""

    async def script(stage: Stage) -> None:
        stage.kill("px4_bridge")
        stage.flight.vehicle.pilot(KillSwitch(True))
        await asyncio.sleep(1.5)
        assert height_m(stage) < DOWN_M
        stage.flight.vehicle.pilot(KillSwitch(False))
        await asyncio.sleep(1.0)
        assert (height_m(stage) > 1.0) == flies_again

    walking(tmp_path, script, COM_KILL_DISARM=disarms_s)
