"""`clew preflight`: what stands against a flight, with cures, of what this host has: vehicle, motion capture, clocks.

The bridge must not run meanwhile: the link belongs to one of both.
"""

import asyncio
import sys
from collections.abc import Iterable

from services.config import Config, load, told_in
from services.console import vehicle_link
from services.console.preflight_ground import look_at_capture, look_at_clocks
from services.console.start import check_devices, check_radio
from services.profile_file import ConfigError
from services.px4_bridge.preflight import Found, Reason, differing, reasons
from services.px4_bridge.vehicle import MavsdkVehicle
from services.px4_bridge.vehicle_protocol import Vehicle, VehicleError
from services.runtime.clock import MonotonicClock

_BATTERY_S = 3.0


def preflight(profile: str, fix: bool) -> int:
    """Print the list. Returns the exit code: 0 for an empty one, 1 when something stands against it, 2 for bad input.

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
    listed = asyncio.run(_look_at_all(config, fix))
    for n, (what, cure) in enumerate(listed, start=1):
        print(f"{n}. {what}: {cure}")  # noqa: T201
    print("it may fly" if not listed else f"{len(listed)} against a flight")  # noqa: T201
    return 1 if listed else 0


async def _look_at_all(config: Config, fix: bool) -> list[Reason]:
    listed = await _look_at_vehicle(config, fix) if "px4_bridge" in config.system.services else []
    listed += await look_at_capture(config) if "tracker" in config.system.services else []
    return listed + await look_at_clocks(config)


async def _look_at_vehicle(config: Config, fix: bool) -> list[Reason]:
    url = config.px4_bridge.link.url
    if heard := vehicle_link.silence(url):
        return [Reason(heard, "and no other program may have the device open")]
    try:
        return await _connected(config, fix)
    except VehicleError as error:
        return [Reason(str(error), "check power, cable, port and baud rate of px4_bridge.link.url")]


async def _connected(config: Config, fix: bool) -> list[Reason]:
    link = config.px4_bridge.link
    now_ns = MonotonicClock().now_ns
    async with MavsdkVehicle.connect(link.url, config.px4_bridge.vehicle, now_ns, link.timeout_s) as vehicle:
        return await look(config, vehicle, fix=fix)


async def look(config: Config, vehicle: Vehicle, *, fix: bool) -> list[Reason]:
    """The list for a connected vehicle; `fix` first sets what differs, if it is not armed. Raises VehicleError."""
    wanted = config.px4_bridge.px4
    found = await _found(vehicle, wanted)
    if fix and not found.armed:
        for name, value in differing(found.parameters, wanted).items():
            await vehicle.set_parameter(name, value)
        found = await _found(vehicle, wanted)
    return reasons(found, wanted, config.safety_supervisor.limits.battery_warn_fraction)


async def _found(vehicle: Vehicle, names: Iterable[str]) -> Found:
    parameters: dict[str, int | float] = {}
    for name in names:
        try:
            parameters[name] = await vehicle.get_parameter(name)
        except VehicleError:
            continue  # told as missing
    for _ in range(round(_BATTERY_S / 0.1)):
        if vehicle.sample.battery_fraction > 0.0:
            break
        await asyncio.sleep(0.1)
    return Found(parameters, vehicle.sample.armed, vehicle.sample.battery_fraction)
