"""A ground station of its own beside PX4 in software: what a pilot does there, and PX4's heartbeats as nobody bends them."""

import itertools
import struct
from collections.abc import Iterator

from schemas.vehicle import FlightMode
from services.px4_bridge import telecommand, telemetry
from services.rehearsal.mavlink_peer import MavlinkPeer
from services.simulator.commander import Arm, Request, SetOrigin, SetParameter, Switch

ASK_STEPS = 4
"""PX4 beats at 1 Hz and lets nobody change that: too rare to time anything by. But it answers whoever asks for a beat."""
_HEARTBEAT = 0
_STATION = (255, 190)
_INT32, _REAL32 = 6, 9


class GroundStation:
    """At the port where PX4 expects one. Without heartbeats of its own: nobody is to miss it."""

    def __init__(self, port: int, vehicle: int = 1) -> None:
        self._peer = MavlinkPeer(_STATION, ("HEARTBEAT",), vehicle=vehicle, to=port)
        self._steps = itertools.count()

    def close(self) -> None:
        """Free the port."""
        self._peer.close()

    def modes(self) -> Iterator[tuple[FlightMode, bool]]:
        """To be called each step. Of each heartbeat that has come: the mode, and whether it is armed."""
        for message in self._peer.messages():
            fields = message.to_dict()
            yield telemetry.mode_of(fields), telemetry.is_armed(fields)
        if next(self._steps) % ASK_STEPS == 0:
            self._peer.command(telecommand.command(telecommand.REQUEST, _HEARTBEAT))

    def ask(self, asked: Request) -> None:
        """As somebody who sits there would. Raises ValueError for what cannot be asked for."""
        match asked:
            case Switch(mode=mode):
                self._peer.command(telecommand.mode(FlightMode(mode.value)))
            case Arm(armed=armed, force=force):
                forced = telecommand.FORCED if force else 0.0
                self._peer.command(telecommand.command(telecommand.ARM, float(armed), forced))
            case SetOrigin():
                self._peer.place()
            case SetParameter(name=name, value=value):
                self._set(name, value)
            case _:
                raise ValueError(f"{asked}: no pilot asks for that")

    def _set(self, name: str, value: int | float) -> None:
        """PARAM_SET: an integer travels as the float with the same bits."""
        whole = isinstance(value, int)
        sent: float = struct.unpack("<f", struct.pack("<i", value))[0] if whole else value
        told = {"param_id": name.encode(), "param_value": sent, "param_type": _INT32 if whole else _REAL32}
        self._peer.send("param_set", self._peer.target | told)
