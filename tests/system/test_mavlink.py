"""Real MAVSDK against the stand-in autopilot over UDP: the whole border, both sides."""

import asyncio
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from schemas.vehicle import FlightMode
from services.physics import GRAVITY_MPS2
from services.px4_bridge.telemetry import ImuSample
from services.px4_bridge.vehicle import MavsdkVehicle, VehicleError
from services.simulator.autopilot import STEP_S, Pose
from services.simulator.commander import Mode
from services.simulator.mavlink import Wire
from services.simulator.mavlink_streams import streams
from tests.system.played import PATIENCE_S, VEHICLE, Played, connected, fed, wait_for

HIGHRES_IMU = 105


@pytest.fixture
def port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def played(port: int) -> Iterator[Played]:
    with Played(port).playing() as played:
        yield played


def test_a_whole_flight(played: Played) -> None:
    async def fly() -> None:
        async with connected(played) as vehicle, fed(vehicle, played, fly=True):
            await wait_for(lambda: vehicle.sample.has_position)
            await vehicle.set_mode(FlightMode.OFFBOARD)
            assert played.drone.mode is Mode.OFFBOARD
            await asyncio.sleep(0.5)
            await vehicle.arm()
            assert played.drone.armed
            await wait_for(lambda: vehicle.sample.in_air and vehicle.sample.p_W[2] > 0.7)
            assert abs(vehicle.sample.p_W[2] - played.drone.robot.p_W[2]) < 0.2
            assert 0.7 < vehicle.drain_imu()[-1].thrust_N / (0.8 * GRAVITY_MPS2) < 1.5
            with pytest.raises(VehicleError, match="disarm: denied"):
                await vehicle.disarm()
            await vehicle.set_mode(FlightMode.LAND)
            assert vehicle.sample.mode is FlightMode.LAND
            await wait_for(lambda: not vehicle.sample.armed and not vehicle.sample.in_air)
            assert "Disarmed by landing" in vehicle.drain_texts()

    asyncio.run(fly())


def test_set_points_arrive_as_sent_and_none_after_the_last_call(played: Played) -> None:
    values = np.random.default_rng(1).uniform(-2.0, 2.0, (200, 10)).astype(np.float32).astype(float)

    async def send() -> None:
        async with connected(played) as vehicle:
            for value in values:
                vehicle.send_setpoint(value[:3], value[3:6], value[6:9], value[9])
                await asyncio.sleep(0.002)
            await wait_for(lambda: len(played.setpoints) >= len(values))
            await asyncio.sleep(0.5)

    asyncio.run(send())
    assert len(played.setpoints) == len(values)
    arrived = np.array([np.concatenate((s.p_W, s.v_W, s.a_W)) for s in played.setpoints])
    np.testing.assert_array_equal(arrived, values[:, :9])
    np.testing.assert_allclose([float(s.yaw_rad) for s in played.setpoints], values[:, 9], atol=1e-6)


def test_what_is_not_set_is_masked(played: Played) -> None:
    async def send() -> None:
        async with connected(played) as vehicle:
            vehicle.send_setpoint(None, np.array([np.nan, 0.0, -0.5]), None, None)
            with pytest.raises(ValueError, match="must be finite"):
                vehicle.send_setpoint(np.array([np.inf, 0.0, 0.0]), None, None, None)
            await wait_for(lambda: len(played.setpoints) > 0)

    asyncio.run(send())
    (setpoint,) = played.setpoints
    assert np.isnan(setpoint.p_W).all()
    assert np.isnan(setpoint.a_W).all()
    assert np.isnan(setpoint.yaw_rad)
    np.testing.assert_array_equal(setpoint.v_W, [np.nan, 0.0, -0.5])


def test_the_quick_way_to_send_writes_the_dialects_own_bytes() -> None:
    def written(send: Callable[[Any], None]) -> list[bytes]:
        packets = list[bytes]()
        wire = Wire(SimpleNamespace(write=lambda packet: packets.append(bytes(packet))), 1, 1)
        for _ in range(2):  # the sequence counts on
            send(wire)
        return packets

    imu = (123_456_789, *np.linspace(-9.0, 9.0, 13).tolist(), 63, 0)
    assert written(lambda wire: wire.send_fields(105, *imu)) == written(lambda wire: wire.highres_imu_send(*imu))
    motors = [0.25, 0.5, 0.0, 1.0] + [0.0] * 28
    assert written(lambda wire: wire.send_fields(375, 7, 15, *motors)) == written(
        lambda wire: wire.actuator_output_status_send(7, 15, motors)
    )
    assert written(lambda wire: wire.send_fields(32, 0, *[0.0] * 6)) == written(
        lambda wire: wire.local_position_ned_send(0, *[0.0] * 6)
    )


def test_every_inertial_sample_arrives_and_none_twice(played: Played) -> None:
    async def count() -> None:
        async with connected(played) as vehicle:
            await wait_for(lambda: bool(vehicle.drain_imu()))
            sent_before, samples = played.link.sent[HIGHRES_IMU], list[ImuSample]()
            async with asyncio.timeout(PATIENCE_S):
                while len(samples) < 250:
                    await vehicle.wait_imu()
                    samples += vehicle.drain_imu()
            sent = played.link.sent[HIGHRES_IMU] - sent_before
            late = vehicle._telemetry.dropped  # not fetched in time, on a machine that stalls
        stamps = [sample.stamp_ns for sample in samples]
        assert 0.95 * sent < len(stamps) + late <= sent + 10  # some may have been on their way at the start
        assert np.median(np.diff(stamps)) == pytest.approx(1e9 * STEP_S, rel=0.05)
        assert np.all(np.diff(stamps) > 0)
        np.testing.assert_allclose(samples[-1].specific_force_B, [0.0, 0.0, GRAVITY_MPS2], atol=1e-5)
        np.testing.assert_allclose(samples[-1].q_WB_wxyz, [1.0, 0.0, 0.0, 0.0], atol=1e-6)
        assert samples[-1].thrust_N == 0.0

    asyncio.run(count())


def test_offboard_without_a_stream_is_acknowledged_but_arming_is_not(played: Played) -> None:
    async def ask() -> None:
        async with connected(played) as vehicle, fed(vehicle, played, fly=False):
            await wait_for(lambda: vehicle.sample.has_position)
            await vehicle.set_mode(FlightMode.OFFBOARD)
            with pytest.raises(VehicleError, match="arm: denied by the autopilot"):
                await vehicle.arm()
            with pytest.raises(ValueError, match="cannot be asked for"):
                await vehicle.set_mode(FlightMode.DESCEND)
        assert not played.drone.armed

    asyncio.run(ask())


def test_hold_is_entered_once_there_is_an_origin(played: Played) -> None:
    async def hold() -> None:
        async with connected(played) as vehicle, fed(vehicle, played, fly=False):
            await wait_for(lambda: vehicle.sample.has_position)
            await vehicle.set_mode(FlightMode.HOLD)
            with pytest.raises(VehicleError, match="denied"):
                await vehicle.arm()
            await vehicle.set_origin()
            await wait_for(lambda: played.drone.state.commander.has_origin)
            await vehicle.arm()
            await vehicle.disarm()
            await vehicle.terminate()
            assert played.drone.state.commander.terminated

    asyncio.run(hold())


def test_parameters_go_both_ways_with_their_types(played: Played) -> None:
    async def turn() -> None:
        async with connected(played) as vehicle:
            assert await vehicle.get_parameter("COM_OBL_RC_ACT") == 4
            await vehicle.set_parameter("COM_OBL_RC_ACT", 5)
            await vehicle.set_parameter("COM_OF_LOSS_T", 1.5)
            assert await vehicle.get_parameter("COM_OBL_RC_ACT") == 5
            assert await vehicle.get_parameter("COM_OF_LOSS_T") == 1.5
            with pytest.raises(VehicleError, match="parameter NO_SUCH"):
                await vehicle.get_parameter("NO_SUCH")
        assert played.drone.state.px4["COM_OF_LOSS_T"] == 1.5

    asyncio.run(turn())


def test_poses_arrive_in_our_frame(played: Played) -> None:
    async def send() -> None:
        async with connected(played) as vehicle:
            vehicle.send_pose(np.array([1.0, 2.0, 3.0]), np.array([1.0, 0.0, 0.0, 0.0]), time.monotonic_ns())
            await wait_for(lambda: any(isinstance(item, Pose) for item in played.received))

    asyncio.run(send())
    (pose,) = (item for item in played.received if isinstance(item, Pose))
    np.testing.assert_array_equal(pose.p_W, [1.0, 2.0, 3.0])


def test_a_silent_vehicle_is_not_connected_and_gets_its_rates_back(played: Played) -> None:
    async def lose() -> None:
        async with connected(played) as vehicle:
            await wait_for(lambda: vehicle.sample.connected)
            played.silent = True
            await wait_for(lambda: not vehicle.sample.connected)
            played.link._streams = streams()  # as after a restart
            played.silent = False
            await wait_for(lambda: vehicle.sample.connected)
            await wait_for(lambda: played.link._streams[-3].interval_us == 1e6 * STEP_S)

    asyncio.run(lose())


def test_no_autopilot_is_one_clear_error(port: int) -> None:
    async def connect() -> None:
        async with MavsdkVehicle.connect(f"udpin://127.0.0.1:{port}", VEHICLE, time.monotonic_ns, timeout_s=0.3):
            pass

    with pytest.raises(VehicleError, match=rf"no autopilot on udpin://127.0.0.1:{port} within 0.3 s"):
        asyncio.run(connect())


def test_a_port_in_use_is_named(port: int) -> None:
    async def connect() -> None:
        async with MavsdkVehicle.connect(f"udpin://127.0.0.1:{port}", VEHICLE, time.monotonic_ns):
            pass

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as squatter:
        squatter.bind(("127.0.0.1", port))
        with pytest.raises(VehicleError, match=f"port {port} is in use"):
            asyncio.run(connect())


def test_a_bad_url_is_named() -> None:
    async def connect() -> None:
        async with MavsdkVehicle.connect("nonsense://x", VEHICLE, time.monotonic_ns, timeout_s=0.3):
            pass

    with pytest.raises(VehicleError, match="cannot open nonsense://x"):
        asyncio.run(connect())


CRASH = """
import asyncio, time
import numpy as np
from tests.system.played import VEHICLE
from services.px4_bridge.vehicle import MavsdkVehicle

async def main():
    async with MavsdkVehicle.connect({url!r}, VEHICLE, time.monotonic_ns, 20.0, 20.0) as vehicle:
        vehicle.send_setpoint(np.zeros(3), np.zeros(3), np.zeros(3), 0.0)
        raise RuntimeError("the end")

asyncio.run(main())
"""


def test_a_process_that_crashes_ends_and_says_nothing_more(played: Played) -> None:
    crashed = subprocess.run(
        [sys.executable, "-c", CRASH.format(url=played.url)],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        timeout=3 * PATIENCE_S,
        text=True,
        check=False,
    )
    assert crashed.returncode == 1
    assert "RuntimeError: the end" in crashed.stderr
    time.sleep(0.5)
    assert len(played.setpoints) == 1
