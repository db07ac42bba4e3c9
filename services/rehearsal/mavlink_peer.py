# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
"""One end of a MAVLink 2 connection over UDP without a thread: what has come is taken when somebody asks for it."""

import select
import socket
from collections.abc import Iterable, Iterator
from typing import Any

from services.px4_bridge import telecommand
from services.px4_bridge.telecommand import AUTOPILOT, Fields
from services.simulator.wire import Wire, frames, numbers

_DATAGRAM_BYTES = 65536


class MavlinkPeer:
    """Talks to the autopilot of `vehicle` on this host: at `to`, a port, or where the first word comes from."""

    def __init__(
        self, sender: tuple[int, int], wanted: Iterable[str], *, vehicle: int = 1, port: int = 0, to: int = 0
    ) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self._socket.setblocking(False)
        self._other: Any = ("127.0.0.1", to) if to else None
        self._wire = Wire(self, *sender)
        self._wanted = numbers(wanted)
        self.target: Fields = {"target_system": vehicle, "target_component": AUTOPILOT}
        """The fields that address it."""

    def close(self) -> None:
        """Free the port."""
        self._socket.close()

    def messages(self) -> Iterator[Any]:
        """All of the autopilot's that have come and are wanted: PX4 says much that nobody listens to."""
        while (data := self._read()) is not None:
            for message_id, component, frame in frames(data):
                if component == AUTOPILOT and message_id in self._wanted:
                    yield self._wire.decode(bytearray(frame))

    def wait(self, seconds: float) -> bool:
        """Whether something comes within so much real time."""
        return seconds > 0.0 and bool(select.select((self._socket,), (), (), seconds)[0])

    def send(self, name: str, fields: Fields) -> None:
        """One message; nothing while nobody is known at the other end."""
        if self._other is not None:
            getattr(self._wire, f"{name}_send")(**fields)

    def command(self, fields: Fields) -> None:
        """A COMMAND_LONG whose answer nobody waits for."""
        self.send("command_long", fields | self.target)

    def place(self) -> None:
        """SET_GPS_GLOBAL_ORIGIN, which has no component."""
        self.send("set_gps_global_origin", telecommand.origin() | {"target_system": self.target["target_system"]})

    def write(self, packet: bytes) -> None:
        """Where the dialect puts a packed message."""
        self._socket.sendto(packet, self._other)

    def _read(self) -> bytes | None:
        try:
            data, self._other = self._socket.recvfrom(_DATAGRAM_BYTES)
        except BlockingIOError:
            return None
        return data
