"""The faults that concern the autopilot, on real PX4 in software. Needs PX4_BIN, as test_px4.py; else skipped.

There, too: a service that dies, set-points that stay away and come back, motion capture that falls silent.
"""

import asyncio
from collections.abc import Callable

import numpy as np
import pytest

from schemas.safety import Action, Level, Phase
from schemas.topics import MOCAP_FRAME, SAFETY_STATE, SETPOINT, TRUTH
from schemas.vehicle import FlightMode
from services.faults.catalogue import named
from services.rehearsal.chain import Flight, Stage
from services.rehearsal.quick import quicker
from tests.processes.window import Window
from tests.services import px4_chain

pytestmark = [
    pytest.mark.skipif(not px4_chain.PX4_BIN, reason="PX4_BIN is not set: no real PX4 to fly"),
    pytest.mark.timeout(300),
]
LOOK_S, DOWN_S = 0.02, 14.0
LANDS = (FlightMode.LAND, FlightMode.DESCEND)


class Seen:
    """What PX4 itself said of its mode after the fault, whoever was left to listen, and what was on the bus."""

    def __init__(self, flight: Flight, begin_s: float, modes: list[tuple[float, FlightMode, bool]]) -> None:
        self.window = Window(flight.said, begin_s)
        self.modes = modes
        self.height_m = flight.said[TRUTH.key][-1].robot_position_m.z

    def lands_s(self) -> float:
        return next((t for t, mode, _ in self.modes if mode in LANDS), np.inf)

    def off_s(self) -> float:
        return next((t for t, _, armed in self.modes if not armed), np.inf)

    def left_armed(self) -> bool:
        return self.modes[-1][2]


def broken(folder, act: Callable[[Stage], object], watch_s: float = DOWN_S) -> Seen:
    """Fly until the person has been guided for 3 s, break, and watch."""
    begun: list[float] = []
    modes: list[tuple[float, FlightMode, bool]] = []

    async def script(stage: Stage) -> None:
        await px4_chain.started(stage)
        await stage.until(lambda state: state.phase is Phase.GUIDING, 60.0)
        await asyncio.sleep(3.0)
        begun.append(stage.now_s)
        act(stage)
        while stage.now_s < begun[0] + watch_s:
            await asyncio.sleep(LOOK_S)
            now = stage.flight.vehicle.sample
            modes.append((stage.now_s - begun[0], now.mode, now.armed))

    flight = px4_chain.fly(quicker(px4_chain.px4_config(folder)), script)
    seen = Seen(flight, begun[0], modes)
    assert seen.window.pull_N(-0.5, 0.0) > 0.5, "nothing was pulling"
    return seen


def test_without_the_bridge_px4_lands_by_itself(tmp_path):
    seen = broken(tmp_path, lambda stage: stage.kill("px4_bridge"))
    assert seen.lands_s() < 1.2
    assert seen.window.silent_s() < 0.02
    assert Level.DESCEND in seen.window.levels()
    assert not seen.left_armed()
    assert seen.height_m < 0.2


def test_without_the_supervisor_the_bridge_eases_then_lands(tmp_path):
    seen = broken(tmp_path, lambda stage: stage.kill("safety_supervisor"))
    assert seen.window.backs_off_s() < 0.3
    assert seen.window.pull_N(0.8, 3.0) < 0.3
    assert 3.0 < seen.lands_s() < 3.8
    assert not seen.left_armed()
    assert seen.height_m < 0.2


@pytest.mark.parametrize("alone", [False, True])
def test_kill_stops_the_motors_for_good(tmp_path, alone):
    """With the supervisor dead too, because the bridge hears the person itself."""

    def act(stage: Stage) -> None:
        if alone:
            stage.kill("safety_supervisor")
        stage.ask(Action.KILL, 99)

    seen = broken(tmp_path, act, watch_s=4.0)
    off_s = seen.off_s()
    assert off_s < 0.3
    assert not any(armed for t, _, armed in seen.modes if t > off_s)
    assert not seen.window.all(SETPOINT, off_s + 0.1)


def test_a_vehicle_that_motion_capture_loses_comes_down_before_its_dead_reckoning_ends(tmp_path):
    """The handle is seen all the while: only the vehicle's markers are gone."""
    lost = named("robot_lost")
    assert lost is not None
    seen = broken(tmp_path, lost.act)
    assert seen.window.all(SAFETY_STATE)
    assert seen.window.heard[MOCAP_FRAME.key][-1].robot.tracked is False
    assert seen.window.backs_off_s() < 2.0
    assert seen.lands_s() < 3.2
    assert not seen.left_armed()
    assert seen.height_m < 0.3
