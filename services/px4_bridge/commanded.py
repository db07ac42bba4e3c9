"""What every vehicle does alike, whatever carries its messages: what it has told, and orders that wait for their answer.

An order is believed when the autopilot's own state shows it, not when it is acknowledged.
"""

import asyncio
from abc import abstractmethod
from collections.abc import Awaitable, Callable

from schemas.vehicle import FlightMode
from services.px4_bridge import telecommand, telemetry
from services.px4_bridge.telecommand import Fields
from services.px4_bridge.telemetry import Checks, ImuSample, Telemetry, VehicleSample
from services.px4_bridge.vehicle_protocol import Vehicle, VehicleError


class CommandedVehicle(Vehicle):
    """A Vehicle but for its wire: that puts what it hears into `_telemetry` and wakes who waits for it."""

    def __init__(self, p: telemetry.Vehicle, now_ns: Callable[[], int], answer_s: float = 3.0) -> None:
        self._now_ns, self._answer_s = now_ns, answer_s
        self._telemetry = Telemetry(p)
        self._imu_arrived = asyncio.Event()
        self._told = asyncio.Event()
        """Set whenever the vehicle may have told a new state."""

    @abstractmethod
    async def _acknowledged(self, fields: Fields) -> int:
        """Send a COMMAND_LONG; the result in its acknowledgement."""

    @property
    def sample(self) -> VehicleSample:  # noqa: D102
        return self._telemetry.sample(self._now_ns())

    @property
    def checks(self) -> Checks:  # noqa: D102
        return self._telemetry.checks

    async def wait_imu(self) -> None:  # noqa: D102
        await self._imu_arrived.wait()

    def drain_imu(self) -> list[ImuSample]:  # noqa: D102
        self._imu_arrived.clear()
        return self._telemetry.drain()

    def drain_texts(self) -> list[str]:  # noqa: D102
        texts = list(self._telemetry.texts)
        self._telemetry.texts.clear()
        return texts

    async def arm(self) -> None:  # noqa: D102
        await self._command("arm", telecommand.command(telecommand.ARM, 1.0))
        await self._shown("arm", lambda now: now.armed)

    async def disarm(self) -> None:  # noqa: D102
        await self._command("disarm", telecommand.command(telecommand.ARM, 0.0))
        await self._shown("disarm", lambda now: not now.armed)

    async def set_mode(self, mode: FlightMode) -> None:  # noqa: D102
        await self._command(f"mode {mode.value}", telecommand.mode(mode))
        await self._shown(f"mode {mode.value}", lambda now: now.mode is mode)

    async def kill(self) -> None:  # noqa: D102
        await self._command("kill", telecommand.command(telecommand.ARM, 0.0, telecommand.FORCED))
        await self._shown("kill", lambda now: not now.armed)

    async def terminate(self) -> None:  # noqa: D102
        await self._command("flight termination", telecommand.command(telecommand.TERMINATE, 1.0))

    async def _command(self, what: str, fields: Fields) -> None:
        await self._accepted(what, self._acknowledged(fields))

    async def _accepted(self, what: str, answer: Awaitable[int]) -> None:
        """Raise VehicleError for any result but MAVLink's 0, and for none in time."""
        try:
            async with asyncio.timeout(self._answer_s):
                result = await answer
        except TimeoutError:
            raise VehicleError(f"{what}: no answer within {self._answer_s:g} s") from None
        if result:
            raise VehicleError(f"{what}: {telecommand.RESULTS.get(result, f'result {result}')} by the autopilot")

    async def _shown(self, what: str, is_so: Callable[[VehicleSample], bool]) -> None:
        """Wait for a state that shows it: acknowledged is not done, and what was told before proves nothing."""
        self._told.clear()
        try:
            async with asyncio.timeout(self._answer_s):
                await self._told.wait()
                await self._until(lambda: is_so(self.sample))
        except TimeoutError:
            raise VehicleError(f"{what}: acknowledged, but not seen within {self._answer_s:g} s") from None

    async def _until(self, is_so: Callable[[], bool]) -> None:
        while not is_so():
            self._told.clear()
            await self._told.wait()
