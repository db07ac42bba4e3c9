"""Whether the vehicle's link can be opened: looked at before anything starts, each fault a line that says what to do."""

import os
import select
import socket
import stat
import termios
import time
from contextlib import closing
from pathlib import Path

from services.profile_file import ConfigError

KEY = "px4_bridge.link.url"
_LISTEN_S = 1.5
"""A PX4 sends heartbeats once a second, asked or not."""


def check(url: str) -> None:
    """Scheme, device, baud rate, port. Raises ConfigError."""
    scheme, _, rest = url.partition("://")
    match scheme:
        case "serial":
            path, rate = _serial(url, rest)
            _check_device(url, path)
            _speed(url, rate)
        case "udpin":
            _check_port(url, *_host_and_port(url, rest))
        case "udpout" | "tcpout":
            host, _ = _host_and_port(url, rest)
            _resolve(url, host)
        case _:
            raise _fault(url, "must begin with serial://, udpin://, udpout:// or tcpout://")


def silence(url: str) -> str:
    """Why nothing that can be understood comes over a serial link that is open to us; empty where MAVLink does.

    Listens for a while, so nobody else may have the device open. Raises ConfigError as `check`.
    """
    scheme, _, rest = url.partition("://")
    if scheme != "serial":
        return ""
    path, rate = _serial(url, rest)
    heard = _listen(url, path, rate)
    if _has_mavlink(heard):
        return ""
    if not heard:
        return f"{path}: nothing is heard in {_LISTEN_S:g} s: is the autopilot on, TX to RX, MAV_n_CONFIG on that port?"
    return f"{path}: {len(heard)} bytes, but no MAVLink at {rate} baud: set SER_..._BAUD and {KEY} to the same rate"


def _serial(url: str, rest: str) -> tuple[str, int]:
    path, _, rate = rest.rpartition(":")
    if not path.startswith("/") or not rate.isdigit():
        raise _fault(url, "must be serial:///dev/NAME:BAUD, as in serial:///dev/ttyUSB0:921600")
    return path, int(rate)


def _check_device(url: str, path: str) -> None:
    try:
        kind = Path(path).stat().st_mode
    except OSError:
        there = sorted(
            str(file) for pattern in ("ttyUSB*", "ttyACM*", "ttyAMA*") for file in Path("/dev").glob(pattern)
        )
        raise _fault(url, f"no such device: is it plugged in? There are: {', '.join(there) or 'none'}") from None
    if not stat.S_ISCHR(kind):
        raise _fault(url, f"{path} is not a serial device")
    if not os.access(path, os.R_OK | os.W_OK):
        raise _fault(url, f"{path} may not be opened: add this user to the group dialout, and log in anew")


def _speed(url: str, rate: int) -> int:
    """As termios calls it."""
    known = {int(name[1:]): getattr(termios, name) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()}
    if rate < 9600 or rate not in known:
        usual = ", ".join(str(r) for r in sorted(known) if r >= 57600)
        raise _fault(url, f"no such baud rate: must be the autopilot's SER_..._BAUD, usually 921600; one of {usual}")
    return known[rate]


def _host_and_port(url: str, rest: str) -> tuple[str, int]:
    host, _, port = rest.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise _fault(url, "must end with HOST:PORT, as in udpin://0.0.0.0:14540")
    return host, int(port)


def _resolve(url: str, host: str) -> str:
    try:
        return str(socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_DGRAM)[0][4][0])
    except OSError as error:
        raise _fault(url, f"{host} does not resolve: {error.strerror or error}") from None


def _check_port(url: str, host: str, port: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((_resolve(url, host), port))
        except OSError as error:
            why = f"port {port}: {(error.strerror or str(error)).lower()}"
            raise _fault(
                url, f"{why}: stop the ground station, bridge or demo that listens there, or take another"
            ) from None


def _listen(url: str, path: str, rate: int) -> bytes:
    """What comes over the line at that rate, raw."""
    speed, heard, until_s = _speed(url, rate), b"", time.monotonic() + _LISTEN_S
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    with closing(os.fdopen(fd, "rb", buffering=0)):
        termios.tcsetattr(
            fd, termios.TCSANOW, [0, 0, termios.CS8 | termios.CREAD | termios.CLOCAL, 0, speed, speed, [0] * 32]
        )
        while (left_s := until_s - time.monotonic()) > 0:
            if select.select([fd], [], [], left_s)[0]:
                heard += os.read(fd, 4096)
    return heard


def _has_mavlink(heard: bytes) -> bool:
    """Two frames of version 2 or 1 in a row: a length that leads from one beginning to the next."""
    begins = [at for at in range(len(heard) - 2) if heard[at] in (0xFD, 0xFE)]
    ends = [(at, at + _frame_bytes(heard[at : at + 3])) for at in begins]
    return any(end < len(heard) and heard[end] == heard[at] for at, end in ends)


def _frame_bytes(head: bytes) -> int:
    """From a frame's first three bytes: version 2 has a longer header, and a signature where its flag says so."""
    return 12 + head[1] + 13 * (head[2] & 1) if head[0] == 0xFD else 8 + head[1]


def _fault(url: str, why: str) -> ConfigError:
    return ConfigError(f"{KEY} = {url}: {why}")
