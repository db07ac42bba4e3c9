"""What can be done to any vehicle of a rehearsal, and what is written down of it: the stand-in's (direct_vehicle.py) or PX4's."""

import asyncio
from abc import abstractmethod
from collections.abc import Callable
from typing import Self

from schemas.vehicle import FlightMode
from services.px4_bridge import telemetry
from services.px4_bridge.commanded import CommandedVehicle
from services.simulator.commander import Request

UNREAD_S, HEARTBEAT_S = 0.02, 1.0
Messages = list[tuple[str, telemetry.Fields]]
Garble = Callable[[Messages], Messages]


class RehearsedVehicle(CommandedVehicle):
    """The bridge's vehicle, whose link, process and autopilot can be disturbed at any time."""

    def __init__(self, p: telemetry.Vehicle, now_ns: Callable[[], int]) -> None:
        super().__init__(p, now_ns)
        self._p = p
        self.sent_ns: list[int] = []
        """When each set-point was sent."""
        self.modes: list[tuple[int, FlightMode, bool]] = []
        """The autopilot's mode and whether it is armed, from when on."""
        self.cut = False
        """While true nothing passes, in either direction."""
        self.mute = False
        """While true no set-point gets through."""
        self.garble: Garble = lambda messages: messages
        """What happens to the autopilot's messages on their way."""
        self._going = asyncio.Event()
        self._going.set()
        self._unread: list[Callable[[], None]] = []
        self._heartbeat_ns = 0

    def met_anew(self) -> Self:
        """As a process that begins at the bridge's end meets it: in the middle of a second between two heartbeats."""
        if self._telemetry.heartbeats:
            self._telemetry = telemetry.Telemetry(self._p)
            self._heartbeat_ns = self._now_ns() + round(1e9 * HEARTBEAT_S)
        return self

    @abstractmethod
    def pilot(self, asked: Request) -> None:
        """What somebody else tells the autopilot: a pilot, a ground station."""

    @abstractmethod
    def refuse(self, kind: type[Request]) -> None:
        """From now on the autopilot denies requests of that kind."""

    @abstractmethod
    def drain(self, percent: int) -> None:
        """The battery falls to that."""

    def stop(self) -> None:
        """The process at the bridge's end stands still; what arrives meanwhile waits."""
        self._going.clear()

    def go_on(self) -> None:
        """Its loop turns before it has read what waited."""
        self._going.set()
        asyncio.get_running_loop().call_later(UNREAD_S, self._read_on)

    async def wait_imu(self) -> None:
        """As Vehicle.wait_imu, by a process that may stand still."""
        await super().wait_imu()
        await self._going.wait()

    def _arrive(self, take: Callable[[], None]) -> None:
        """Take it, or leave it unread while the process stands still."""
        if self._unread or not self._going.is_set():
            self._unread.append(take)
        else:
            take()

    def _read_on(self) -> None:
        unread, self._unread = self._unread, []
        for take in unread:
            self._arrive(take)

    def _heard(self, messages: Messages) -> None:
        for name, fields in messages:
            if name == "HEARTBEAT" and self._now_ns() < self._heartbeat_ns:
                continue
            self._telemetry.take(name, fields, self._now_ns())

    def _wake(self) -> None:
        """Everything of a step has been taken."""
        if self._telemetry.has_imu:
            self._imu_arrived.set()
        self._told.set()

    def _is_in(self, mode: FlightMode, armed: bool) -> None:
        if not self.modes or self.modes[-1][1:] != (mode, armed):
            self.modes.append((self._now_ns(), mode, armed))
