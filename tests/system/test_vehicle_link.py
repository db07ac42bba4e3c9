"""The vehicle's link before anything starts: what cannot be opened is one line that says why, and what to do."""

import os
import pty
import socket
import threading
import time

import pytest

from services.console import vehicle_link
from services.profile_file import ConfigError


def refused(url: str) -> str:
    with pytest.raises(ConfigError) as why:
        vehicle_link.check(url)
    (line,) = str(why.value).splitlines()
    return line.removeprefix(f"px4_bridge.link.url = {url}: ")


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("usb:///dev/ttyUSB0", "must begin with serial://, udpin://, udpout:// or tcpout://"),
        ("serial:///dev/ttyUSB77", "must be serial:///dev/NAME:BAUD, as in serial:///dev/ttyUSB0:921600"),
        ("serial:///dev/ttyUSB77:921600", "no such device: is it plugged in? There are: "),
        ("serial:///dev:921600", "/dev is not a serial device"),
        ("udpin://0.0.0.0", "must end with HOST:PORT, as in udpin://0.0.0.0:14540"),
        ("udpin://0.0.0.0:99999", "must end with HOST:PORT"),
        ("tcpout://no.such.host.invalid:5760", "no.such.host.invalid does not resolve"),
    ],
)
def test_what_is_no_link_is_refused(url, why):
    assert refused(url).startswith(why)


def test_a_baud_rate_that_no_line_has_is_refused():
    master, slave = pty.openpty()
    try:
        name = os.ttyname(slave)
        vehicle_link.check(f"serial://{name}:921600")
        assert refused(f"serial://{name}:921601").startswith("no such baud rate: must be the autopilot's SER_..._BAUD")
    finally:
        os.close(master)
        os.close(slave)


def test_a_port_that_somebody_has_is_refused():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        assert refused(f"udpin://127.0.0.1:{port}").startswith(f"port {port}: address already in use: stop the ground")
    vehicle_link.check(f"udpin://127.0.0.1:{port}")


def heard(monkeypatch, what: bytes) -> str:
    """What is said of a line over which `what` comes again and again."""
    monkeypatch.setattr(vehicle_link, "_LISTEN_S", 0.4)
    master, slave = pty.openpty()
    over = threading.Event()

    def speak() -> None:
        while not over.is_set():
            os.write(master, what)
            time.sleep(0.05)

    speaking = threading.Thread(target=speak)
    if what:
        speaking.start()
    try:
        return vehicle_link.silence(f"serial://{os.ttyname(slave)}:921600").removeprefix(f"{os.ttyname(slave)}: ")
    finally:
        over.set()
        if what:
            speaking.join()
        os.close(master)
        os.close(slave)


def test_a_line_is_listened_to(monkeypatch):
    heartbeat = bytes([0xFD, 9, 0, 0, 1, 1, 1, 0, 0, 0]) + bytes(9) + b"\x12\x34"
    assert heard(monkeypatch, heartbeat) == ""
    assert heard(monkeypatch, bytes([0xFE, 9, 1, 1, 1, 0]) + bytes(9) + b"\x12\x34") == ""
    assert heard(monkeypatch, b"").startswith("nothing is heard in 0.4 s")
    assert "no MAVLink at 921600 baud" in heard(monkeypatch, bytes(range(1, 250, 7)))


def test_what_does_not_run_over_a_serial_line_is_not_listened_to():
    assert vehicle_link.silence("udpin://0.0.0.0:14540") == ""
