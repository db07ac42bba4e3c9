"""Flights on a capture system that is not the simulator's topic, and on one whose world moves."""

import asyncio
from dataclasses import replace

import numpy as np
import pytest

from schemas.message import Vec3
from schemas.safety import Level, Permit
from schemas.topics import HANDLE_STATE, MOCAP_FRAME, MOCAP_SEEN, ROBOT_POSE, TRUTH, Stance
from schemas.tracking import HandleSource, MocapFrame, RigidBody, StampedBy
from services.config import Config, load
from services.console.rerun import config_with
from services.px4_bridge import service as bridge
from services.recorder import latency
from services.recorder.reading import read
from services.recorder.rerun import rerun
from services.rehearsal.chain import MAVLINK_DELAY_S, ON_THE_BUS_ONLY, Stage, _recording, perform, until_guiding
from services.rehearsal.direct_vehicle import DirectVehicle
from services.rehearsal.quick import quick_config, quicker
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node
from services.runtime.virtual import VirtualClock, run_virtual
from services.simulator import service as simulator
from services.tracker import service as tracker
from services.tracker.bodies import Body, CaptureSystem
from services.tracker.sources import Source
from tests.services.chain import fly

SHIFT = np.array([0.0, 0.5, 0.0])


def moved(body: RigidBody, by) -> RigidBody:
    return body.model_copy(update={"position_m": Vec3.of(body.position_m.array() + by)})


def test_a_world_that_moves_in_flight_is_not_flown_after():
    """PX4 would: it rejects a jump for 1.5 s, then believes it."""
    when, status = [], []

    async def script(stage: Stage) -> None:
        put = stage.bus.put

        def shift(key: str, payload: bytes, stance: Stance) -> None:
            if key == MOCAP_FRAME.key and when:
                frame = MocapFrame.model_validate_json(payload)
                parts = {"robot": moved(frame.robot, SHIFT), "handle": moved(frame.handle, SHIFT)}
                payload = frame.model_copy(update=parts).model_dump_json().encode()
            put(key, payload, stance)

        stage.bus.put = shift
        await until_guiding(stage, for_s=2.0)
        when.append(stage.operator.clock.now_ns())
        await asyncio.sleep(0.7)
        status.extend(m.status for m in stage.flight.said["health/tracker"][-1:])
        await stage.until(lambda state: state.permit is Permit.EASE, 0.1)
        await stage.until(lambda state: state.level is Level.DESCEND, 2.4)
        await asyncio.sleep(1.0)

    flight = fly(quick_config(), script)
    (t_ns,) = when
    assert not [m for m in flight.said[ROBOT_POSE.key] if m.stamp_ns > t_ns]
    believed = [
        m for m in flight.said[HANDLE_STATE.key] if m.stamp_ns > t_ns + 0.4e9 and m.source is HandleSource.MOCAP
    ]
    assert believed == []
    assert "robot jump 0.5" in status[0]
    y = [m.robot_position_m.y for m in flight.said[TRUTH.key] if m.stamp_ns > t_ns]
    print(
        f"moved by {y[0] - min(y):.2f} m against and {max(y) - y[0]:.2f} m with the shift in {len(y) / TRUTH.rate_Hz:.1f} s"
    )
    assert y[0] - min(y) < 0.1  # who believes the shift flies 0.5 m against it


def test_a_tracker_is_started_anew_in_flight_and_the_walk_goes_on():
    async def script(stage: Stage) -> None:

        await until_guiding(stage, for_s=2.0)
        stage.kill("tracker")
        await asyncio.sleep(0.3)
        stage.begin("tracker")
        await asyncio.sleep(2.0)
        await stage.until(lambda state: state.permit is Permit.GUIDE, 3.0)

    fly(quick_config(), script)


@pytest.fixture(scope="module")
def captured(tmp_path_factory) -> tuple[Config, object]:
    """A walk whose frames come to the tracker as from a vendor's client: on its own way, not by the bus."""
    file = tmp_path_factory.mktemp("captured") / "session.mcap"
    system = CaptureSystem(
        host="127.0.0.1",
        robot=Body(body="robot"),
        handle=Body(body="handle"),
        rate_min_Hz=50.0,
        rate_max_Hz=250.0,
        repeat_s=0.3,
        restart_s=3.0,
    )
    config = quicker(load("demo"))
    capturing = replace(config.tracker, source="vrpn", mocap=system)
    config = config.model_copy(update={"tracker": capturing})

    async def deliver(node: Node, put) -> None:
        async for frame in node.stream(MOCAP_FRAME):
            put(frame.model_copy(update={"seq": 0, "said_ns": 0, "inputs": {}, "stamped_by": StampedBy.ARRIVAL}))

    async def tracking(node: Node) -> None:
        arrivals, vendor = node.arrivals(), Node("vendor", node.bus, node.clock, observer=True)
        async with asyncio.TaskGroup() as group:
            group.create_task(deliver(vendor, arrivals.put))
            await tracker.track(node, config, Source(arrivals, MOCAP_SEEN))

    async def flight():
        clock, bus = VirtualClock(), MemoryBus()
        vehicle = DirectVehicle(config.px4_bridge.vehicle, clock.now_ns, MAVLINK_DELAY_S)
        runs = {
            "recorder": _recording(config, file),
            "simulator": lambda node: simulator.play(node, config, vehicle),
            "px4_bridge": lambda node: bridge.fly(node, config, vehicle),
            "tracker": tracking,
        }
        others = [name for name in ON_THE_BUS_ONLY if name != "tracker"]
        return await perform(config, lambda stage: until_guiding(stage, for_s=2.0), bus, clock, vehicle, runs, others)

    run_virtual(flight(), limit_s=100.0)
    return config, read(file)


def test_frames_of_a_real_capture_system_are_recorded_and_the_tracker_runs_again_on_them(captured):
    config, session = captured
    seen = session.table(MOCAP_SEEN)
    assert len(seen["seq"]) > 500
    outcome = rerun(session, "tracker", config_with(session, config, []))
    assert outcome.first is None
    assert outcome.equal
    assert outcome.notes == []


def test_the_way_of_a_frame_to_the_set_point_is_measured_from_where_it_came(captured):
    delays = latency.reactions(captured[1])
    assert next(iter(delays)) == "capture -> tracker"
    assert np.all(delays["total"] >= 0.0)
    assert np.median(delays["total"]) < 0.05
