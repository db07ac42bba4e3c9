"""The bridge on the stand-in autopilot, without a wire: what leaves it, when, and what ends it."""

import asyncio

import numpy as np
import pytest

from schemas.safety import Permit, Phase
from schemas.topics import (
    CABLE_FORCE,
    ENERGY,
    MOCAP_FRAME,
    ROBOT_POSE,
    SAFETY_STATE,
    SETPOINT,
    VEHICLE_STATE,
)
from schemas.vehicle import FlightMode, SetpointKind
from services import cable
from services.config import load
from services.physics import norm
from services.px4_bridge import flight
from services.px4_bridge import service as px4_bridge
from services.px4_bridge.vehicle_protocol import VehicleError
from services.rehearsal import rehearsed_vehicle
from services.rehearsal.chain import Stage, until_guiding
from services.rehearsal.direct_vehicle import DirectVehicle
from services.rehearsal.quick import quick_config
from services.runtime.virtual import VirtualClock
from services.simulator import service as simulator
from tests.services.alone import (
    Alone,
    Feed,
    alone,
    force,
    pose,
    rate_Hz,
    since,
    verdict,
)
from tests.services.chain import check_balance, fly

CONFIG = load("demo")
HAND = CONFIG.guided_path.p(0.2)
PULL = np.array([1.2, 0.0, 1.0])
ABOVE = HAND + cable.offset(PULL, CONFIG.cable)


def serving(module):
    """A service as the launcher runs it."""
    return lambda stage: module.run(stage.node(module.__name__.split(".")[1]), CONFIG)


OVER_START = CONFIG.guided_path.p(0.0) + [0.0, 0.0, 0.5]
HANGING = np.array([0.0, 0.0, CONFIG.px4_bridge.flight.handle_weight_N])


class Flown:
    """The bridge on the stand-in autopilot, and the supervisor's and estimator's words as a test wants them."""

    def __init__(
        self,
        safety: Feed,
        seconds: float,
        forces: Feed = lambda _: force(HANGING),
        cut_s: tuple[float, float] | None = None,
    ) -> None:
        self._seconds, self._cut_s = seconds, cut_s
        self.cancelled_at_s = np.inf
        self.after_cancel = 0
        self.said = alone(self._bridge, {SAFETY_STATE: safety, CABLE_FORCE: forces}, self._script)

    async def _bridge(self, stage: Alone) -> None:
        self.vehicle = DirectVehicle(CONFIG.px4_bridge.vehicle, stage.clock.now_ns, 0.003)
        await px4_bridge.fly(stage.node("px4_bridge"), CONFIG, self.vehicle)

    async def _script(self, stage: Alone) -> None:
        await asyncio.sleep(0.0)
        world = asyncio.create_task(simulator.play(stage.node("simulator"), CONFIG, self.vehicle))
        poses = asyncio.create_task(stage.repeat(ROBOT_POSE, lambda _: self._seen(stage)))
        try:
            await self._wait()
            assert stage.task
            stage.task.cancel()
            sent = len(self.vehicle.setpoints)
            await asyncio.sleep(0.2)
            self.after_cancel = len(self.vehicle.setpoints) - sent
        finally:
            world.cancel()
            poses.cancel()

    async def _wait(self) -> None:
        """The connection may be cut for a while."""
        begin_s, end_s = self._cut_s or (self._seconds, self._seconds)
        await asyncio.sleep(begin_s)
        self.vehicle.cut = begin_s < end_s
        await asyncio.sleep(end_s - begin_s)
        self.vehicle.cut = False
        await asyncio.sleep(self._seconds - end_s)

    @staticmethod
    def _seen(stage: Alone):
        frames = stage.said[MOCAP_FRAME.key]
        return pose(frames[-1].robot.position_m.array()) if frames else None

    def kinds(self, begin_s: float, end_s: float) -> set[SetpointKind]:
        return {m.kind for m in since(self.said, SETPOINT, begin_s) if m.stamp_ns * 1e-9 - 1.0 < end_s}

    def state_at(self, t_s: float):
        return since(self.said, VEHICLE_STATE, t_s)[0]


def take_off(t_s: float):
    return verdict(Phase.TAKEOFF, Permit.POSITION, OVER_START)


@pytest.mark.parametrize(
    "safety", [lambda _: None, lambda _: verdict(Phase.IDLE, Permit.NONE)], ids=["no supervisor", "no permit"]
)
def test_without_a_permit_no_set_point_ever_leaves(safety):
    flown = Flown(safety, 1.2)
    assert flown.vehicle.setpoints == []
    assert flown.said[SETPOINT.key] == []
    assert not any(m.armed for m in flown.said[VEHICLE_STATE.key])
    assert flown.state_at(1.0).valid


def test_a_permit_to_guide_on_the_ground_arms_nothing():
    flown = Flown(lambda _: verdict(Phase.GUIDING, Permit.GUIDE, held=True), 1.5)
    assert flown.vehicle.setpoints == []
    assert not any(m.armed for m in flown.said[VEHICLE_STATE.key])


SILENT_FROM_S = 1.7


@pytest.fixture(scope="module")
def orphaned() -> Flown:
    """Take-off; after a while the supervisor falls silent."""
    return Flown(lambda t_s: take_off(t_s) if t_s < SILENT_FROM_S else None, 5.4)


def test_a_take_off_streams_then_takes_over_then_arms(orphaned):
    states = orphaned.said[VEHICLE_STATE.key]
    offboard = next(m.stamp_ns for m in states if m.mode is FlightMode.OFFBOARD)
    armed = next(m.stamp_ns for m in states if m.armed)
    first = orphaned.said[SETPOINT.key][0].stamp_ns
    assert first + 0.5e9 <= offboard <= armed
    assert orphaned.kinds(0.0, SILENT_FROM_S) == {SetpointKind.POSITION}
    assert orphaned.state_at(SILENT_FROM_S - 0.05).armed
    assert rate_Hz(orphaned.said[SETPOINT.key][:200]) == pytest.approx(SETPOINT.rate_Hz, rel=0.02)


def test_a_silent_supervisor_is_an_ease_then_a_landing(orphaned):
    link = CONFIG.px4_bridge.link
    eased_s, landed_s = SILENT_FROM_S + link.permit_silent_s, SILENT_FROM_S + link.permit_lost_s
    assert orphaned.kinds(eased_s + 0.03, landed_s - 0.05) == {SetpointKind.EASE}
    assert orphaned.state_at(landed_s - 0.1).mode is FlightMode.OFFBOARD
    assert orphaned.state_at(landed_s + 0.5).mode is FlightMode.LAND
    assert since(orphaned.said, SETPOINT, landed_s + 0.6) == []


def test_the_books_are_published_at_their_rate_and_close(forsaken):
    """Whatever the filter's end: they stand still while it does not fly, and damping says so."""
    books = forsaken.said[ENERGY.key]
    assert rate_Hz(books) == pytest.approx(50.0, rel=0.02)
    check_balance(books)
    dead_s = DEAD_FROM_S + CONFIG.px4_bridge.link.force_silent_s + 0.03
    after = since(forsaken.said, ENERGY, dead_s)
    assert {m.cable_J for m in after} == {after[0].cable_J}
    assert {m.damping_Ns_per_m.x for m in after} == {0.0}
    waiting = [m for m in since(forsaken.said, ENERGY, WAITING_FROM_S + 0.05) if m.stamp_ns * 1e-9 - 1.0 < DEAD_FROM_S]
    assert {m.damping_Ns_per_m.x for m in waiting} == {CONFIG.px4_bridge.admittance.b_free_Ns_per_m}
    assert all(CABLE_FORCE.key in m.inputs for m in waiting)


def test_set_points_end_with_the_service(orphaned):
    """Whatever ends it: nothing behind it repeats the last one."""
    assert orphaned.vehicle.setpoints
    flown = Flown(take_off, 0.5)
    assert len(flown.vehicle.setpoints) > 30
    assert flown.after_cancel == 0


def test_what_is_sent_is_what_is_said(orphaned):
    told = orphaned.said[SETPOINT.key]
    assert len(told) == len(orphaned.vehicle.setpoints)
    for m, sent in list(zip(told, orphaned.vehicle.setpoints, strict=True))[::20]:
        assert m.position_m.array() == pytest.approx(sent.p_W)
        assert m.acceleration_mps2.array() == pytest.approx(sent.a_W)


WAITING_FROM_S, DEAD_FROM_S, END_S = 1.6, 2.3, 3.3


@pytest.fixture(scope="module")
def forsaken() -> Flown:
    """In the air, waiting for a hand; then the estimator dies."""

    def safety(t_s: float):
        return take_off(t_s) if t_s < WAITING_FROM_S else verdict(Phase.READY, Permit.WAIT, OVER_START)

    return Flown(safety, END_S, lambda t_s: force(HANGING) if t_s < DEAD_FROM_S else None)


def test_what_was_computed_before_a_standstill_is_not_sent_after_it(monkeypatch):
    """A process may be stopped between any two of its instructions."""
    stood_s, turns = 0.3, []
    now_ns, step = VirtualClock.now_ns, flight.step

    def stops_once(*arguments):
        turns.append(VirtualClock().now_ns())
        return step(*arguments)

    monkeypatch.setattr(
        VirtualClock, "now_ns", lambda clock: now_ns(clock) + round(1e9 * stood_s) * (len(turns) >= 100)
    )
    monkeypatch.setattr(flight, "step", stops_once)
    sent_ns = [m.stamp_ns for m in Flown(take_off, 1.6).said[SETPOINT.key]]
    assert turns[98] in sent_ns
    assert turns[99] not in sent_ns
    assert sum(ns > turns[99] for ns in sent_ns) > 20


def test_without_forces_the_filter_stands_still(forsaken):
    assert forsaken.kinds(WAITING_FROM_S + 0.05, DEAD_FROM_S) == {SetpointKind.ADMITTANCE}
    dead_s = DEAD_FROM_S + CONFIG.px4_bridge.link.force_silent_s + 0.03
    assert forsaken.kinds(dead_s, END_S) == {SetpointKind.EASE}
    after = since(forsaken.said, SETPOINT, dead_s)
    assert np.all(np.diff([m.feed_forward for m in after]) <= 0.0)
    assert not np.any([m.u_A_N.array() for m in after])
    way = [m.position_m.array() for m in after]
    assert norm(way[-1] - way[0]) < 0.35


def test_a_force_names_itself_in_the_set_point_it_went_into(forsaken):
    seqs = {m.seq: m.stamp_ns for m in forsaken.said[CABLE_FORCE.key]}
    complying = [
        m for m in since(forsaken.said, SETPOINT, WAITING_FROM_S + 0.05) if m.stamp_ns * 1e-9 - 1.0 < DEAD_FROM_S
    ]
    assert complying
    for m in complying:
        assert m.age_s == pytest.approx((m.stamp_ns - seqs[m.inputs[CABLE_FORCE.key]]) * 1e-9, abs=1e-6)
        assert m.age_s < 0.02


def test_an_autopilot_that_left_offboard_is_not_flown_again_when_it_shows_offboard():
    """After a failsafe's landing PX4 disarms and shows the mode that was asked for, with a heartbeat that is a second old."""
    flown = Flown(lambda t: take_off(t) if t < 6.0 else verdict(Phase.HOLD, Permit.EASE), 18.0, cut_s=(6.0, 7.5))
    modes = [m.mode for m in since(flown.said, VEHICLE_STATE, 6.0)]
    assert FlightMode.LAND in modes
    assert modes[-1] is FlightMode.OFFBOARD
    assert not flown.said[VEHICLE_STATE.key][-1].armed
    assert not since(flown.said, SETPOINT, 8.0)


def test_a_bridge_that_begins_in_flight_does_not_take_the_vehicle_back_however_soon_it_is(monkeypatch):
    """The autopilot has not missed the old one's set-points yet, and would take the new one's."""
    monkeypatch.setattr(rehearsed_vehicle, "HEARTBEAT_S", 0.0)
    killed_ns = []

    async def script(stage: Stage) -> None:
        await until_guiding(stage, for_s=1.0)
        stage.kill("px4_bridge")
        killed_ns.append(stage.operator.clock.now_ns())
        await asyncio.sleep(0.2)
        stage.begin("px4_bridge")
        await asyncio.sleep(2.0)

    flight = fly(quick_config(), script)
    modes = [mode for at_ns, mode, _ in flight.vehicle.modes if at_ns > killed_ns[0]]
    assert modes == [FlightMode.LAND]
    assert flight.vehicle.sent_ns[-1] <= killed_ns[0]


def test_a_vehicle_of_another_kind_is_refused_before_it_is_armed():
    """MAV_TYPE 1 is an aeroplane."""
    refused = []

    def as_another(messages):
        return [(name, fields | {"type": 1} if name == "HEARTBEAT" else fields) for name, fields in messages]

    async def fly_it(stage: Alone) -> None:
        vehicle = DirectVehicle(CONFIG.px4_bridge.vehicle, stage.clock.now_ns, 0.003)
        vehicle.garble = as_another
        world = asyncio.create_task(simulator.play(stage.node("simulator"), CONFIG, vehicle))
        try:
            with pytest.RaisesGroup(pytest.RaisesExc(VehicleError, match=r"no quadrotor \(MAV_TYPE = 1, must be 2\)")):
                await px4_bridge.fly(stage.node("px4_bridge"), CONFIG, vehicle)
            refused.append(vehicle.sample.armed)
            await asyncio.sleep(10.0)
        finally:
            world.cancel()

    alone(fly_it, {SAFETY_STATE: take_off}, lambda _: asyncio.sleep(3.0))
    assert refused == [False]
