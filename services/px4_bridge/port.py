"""Whether the port of a vehicle's link is free."""

import socket

from services.px4_bridge.vehicle_protocol import VehicleError


def refuse_used(url: str) -> None:
    """MAVSDK shares a UDP port with whoever has it already, and then each gets a part of the messages. Raises VehicleError."""
    scheme, _, address = url.partition("://")
    host, _, port = address.partition(":")
    if scheme not in ("udpin", "udp") or not port.isdigit():
        return
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((host, int(port)))
        except OSError as error:
            raise VehicleError(f"cannot open {url}: port {port} is in use ({error.strerror})") from error
