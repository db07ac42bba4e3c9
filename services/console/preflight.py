"""`clew preflight`: what stands against a flight, with cures, of what this host has: vehicle, motion capture, clocks, recordings.

The bridge must not run meanwhile. Before it can say whether it may be armed, the autopilot wants poses, and set-points with
offboard mode selected. It gets both for a few seconds, unarmed: poses from the capture system, or from a tracker that runs; as
the set-point the place where it stands.
"""

import asyncio
import sys
from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import numpy as np

from schemas.topics import ROBOT_POSE
from schemas.vehicle import FlightMode
from services.config import Config, load, told_in
from services.console import vehicle_link
from services.console.look import with_node
from services.console.preflight_ground import look_at_capture, look_at_clocks
from services.console.preflight_tare import look_at_tare
from services.console.start import check_devices, check_radio, services_of
from services.profile_file import ConfigError
from services.px4_bridge.preflight import (
    KILL_SWITCH,
    Estimate,
    Found,
    Identity,
    Reason,
    Thrust,
    Wanted,
    differing,
    heeds_a_pilot,
    reasons,
)
from services.px4_bridge.vehicle import MavsdkVehicle
from services.px4_bridge.vehicle_protocol import LINK_CURE, Vehicle, VehicleError
from services.runtime.clock import MonotonicClock
from services.runtime.node import Node
from services.tracker.sources import open_source

_BATTERY_S, _REST_S, _STREAM_S = 3.0, 1.0, 1.0
_READY_S = 12.0
"""PX4's heading is stable about 8 s after the first pose."""
_PERIOD_S = 0.02
SESSIONS = Path("sessions")


def preflight(profile: str, fix: bool, sessions: Path = SESSIONS) -> int:
    """Print the list; `sessions` is where recordings are.

    Returns the exit code: 0 for an empty one, 1 when something stands against it, 2 for bad input.
    Bad input is a profile, a link that cannot be opened, and for a system on two hosts this one's certificates and addresses.
    """
    try:
        config = load(profile)
        with told_in(profile):
            check_radio(config)
            check_devices(config, config.system.services)
    except ConfigError as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2

    async def listed(node: Node, _bus: object) -> int:
        return _print(await _look_at_all(config, node, fix) + look_at_tare(config, sessions))

    return with_node(profile, listed)


def _print(listed: list[Reason]) -> int:
    for n, (what, cure) in enumerate(listed, start=1):
        print(f"{n}. {what}: {cure}")  # noqa: T201
    print("it may fly" if not listed else f"{len(listed)} against a flight")  # noqa: T201
    return 1 if listed else 0


async def _look_at_all(config: Config, node: Node, fix: bool) -> list[Reason]:
    listed = await _look_at_vehicle(config, node, fix) if "px4_bridge" in config.system.services else []
    listed += await look_at_capture(config) if "tracker" in config.system.services else []
    return listed + await look_at_clocks(config, node)


async def _look_at_vehicle(config: Config, node: Node, fix: bool) -> list[Reason]:
    if heard := vehicle_link.silence(config.px4_bridge.link.url):
        return [Reason(heard, "and no other program may have the device open")]
    try:
        return await _connected(config, node, fix)
    except VehicleError as error:
        return [Reason(str(error).removesuffix(f": {LINK_CURE}"), LINK_CURE)]


async def _connected(config: Config, node: Node, fix: bool) -> list[Reason]:
    link = config.px4_bridge.link
    now_ns = MonotonicClock().now_ns
    async with (
        MavsdkVehicle.connect(link.url, config.px4_bridge.vehicle, now_ns, link.timeout_s) as vehicle,
        posing(config, node, vehicle) as poses,
    ):
        return await look(config, vehicle, poses, fix=fix)


class Poses:
    """How many the vehicle has been given."""

    count = 0


@asynccontextmanager
async def posing(config: Config, node: Node, vehicle: Vehicle) -> AsyncGenerator[Poses]:
    """The vehicle is given poses meanwhile: those of a tracker that runs, or of the capture system itself."""
    poses = Poses()

    async def tracked() -> None:
        async for pose in node.stream(ROBOT_POSE):
            if pose.valid:
                vehicle.send_pose(pose.position_m.array(), pose.q_WB_wxyz.array(), pose.stamp_ns)
                poses.count += 1

    async def captured() -> None:
        await asyncio.sleep(_REST_S)
        if poses.count:
            return
        async with open_source(config.tracker, node) as source:
            async for frame in source.frames:
                if frame.robot.tracked:
                    vehicle.send_pose(frame.robot.position_m.array(), frame.robot.q_WB_wxyz.array(), frame.stamp_ns)
                    poses.count += 1

    tasks = [asyncio.create_task(tracked()), asyncio.create_task(captured())]
    try:
        yield poses
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def look(config: Config, vehicle: Vehicle, poses: Poses, *, fix: bool) -> list[Reason]:
    """The list for a connected vehicle; `fix` first sets what differs, if it is not armed. Raises VehicleError."""
    names, refused = config.px4_bridge.px4, list[str]()
    asked = (*names, KILL_SWITCH) if heeds_a_pilot(names) else names
    parameters = await _parameters(vehicle, asked)
    if fix and not vehicle.sample.armed:
        for name, value in differing(parameters, names).items():
            try:
                await vehicle.set_parameter(name, value)
            except VehicleError as error:
                refused.append(str(error))
        parameters = await _parameters(vehicle, asked)
    return reasons(await _found(vehicle, poses, parameters, refused), _wanted(config))


def _wanted(config: Config) -> Wanted:
    p, simulated = config.px4_bridge.vehicle, "simulator" in services_of(config)
    calibrated = config.calibration.thrust is not None
    return Wanted(
        config.px4_bridge.px4,
        Thrust(p.thrust_source, p.thrust_error, simulated, calibrated),
        config.px4_bridge.flight.m_R_kg,
        config.force_estimator.bias.tare_bias_max_N,
        config.safety_supervisor.limits.battery_warn_fraction,
    )


async def _found(vehicle: Vehicle, poses: Poses, parameters: dict[str, int | float], refused: list[str]) -> Found:
    with suppress(VehicleError):  # told as a version of zeros
        await vehicle.ask_version()
    felt = await _at_rest(vehicle)
    arming = [] if vehicle.sample.armed else await _arming(vehicle)
    for _ in range(round(_BATTERY_S / 0.1)):
        if vehicle.sample.battery_fraction > 0.0:
            break
        await asyncio.sleep(0.1)
    checks, now = vehicle.checks, vehicle.sample
    known = now.has_position and bool(np.isfinite((checks.horizontal_m, checks.vertical_m)).all())
    return Found(
        Identity(checks.autopilot, checks.vehicle_type, checks.version),
        parameters,
        refused,
        now.armed,
        felt,
        poses.count,
        Estimate(known, checks.horizontal_m, checks.vertical_m),
        arming,
        now.battery_fraction,
        checks.pilot,
    )


async def _at_rest(vehicle: Vehicle) -> float:
    """Mean length of the specific force in m/s²; 0 where there is none."""
    vehicle.drain_imu()
    felt = list[float]()
    for _ in range(round(_REST_S / 0.1)):
        await asyncio.sleep(0.1)
        felt += [float(np.linalg.norm(sample.specific_force_B)) for sample in vehicle.drain_imu()]
    return float(np.mean(felt)) if felt else 0.0


async def _arming(vehicle: Vehicle) -> list[str]:
    """What stands against arming in offboard mode, which is selected for it, as in a flight. Nothing is armed."""
    problems, asked = ["its checks before arming were not told"], False
    for n in range(round(_READY_S / _PERIOD_S)):
        vehicle.send_setpoint(vehicle.sample.p_W, None, None, None)
        await asyncio.sleep(_PERIOD_S)
        if n * _PERIOD_S < _STREAM_S or n % 50:
            continue
        if not asked:
            try:
                await vehicle.set_mode(FlightMode.OFFBOARD)
                asked = True
            except VehicleError as error:
                problems = [str(error)]
            continue
        problems = await _problems(vehicle)
        if not problems:
            break
    return problems


async def _problems(vehicle: Vehicle) -> list[str]:
    """In its words, by its events; of an autopilot without them only whether there are any."""
    try:
        return await vehicle.arming_problems()
    except VehicleError as error:
        return [] if vehicle.checks.ready else [f"it is not ready to be armed, and does not say why ({error})"]


async def _parameters(vehicle: Vehicle, names: Iterable[str]) -> dict[str, int | float]:
    parameters: dict[str, int | float] = {}
    for name in names:
        try:
            parameters[name] = await vehicle.get_parameter(name)
        except VehicleError:
            continue  # told as missing
    return parameters
