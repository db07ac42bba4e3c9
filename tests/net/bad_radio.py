"""A bad radio between two network namespaces, in user space: delay, jitter, loss, rate and outages. Needs root.

`python bad_radio.py NS_A NS_B` puts a TUN device into each (10.78.0.1 and 10.78.0.2) and carries packets between them.
Each line on its standard input is JSON that changes how: {"delay_ms": 20, "jitter_ms": 5, "loss": 0.05, "rate_Mbit_s": 5,
"down": false, "deaf_port": 7447}; a rate of 0 is no limit, a deaf port of 0 none. It ends with its standard input.
"""

import ctypes
import fcntl
import heapq
import json
import os
import random
import select
import struct
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

ADDRESS = {"a": "10.78.0.1", "b": "10.78.0.2"}
BUFFER_bytes = 64_000
"""What a radio holds before it drops: a tenth of a second at 5 Mbit/s."""

_TUNSETIFF, _TUN_NO_HEADER = 0x400454CA, 0x1001
_libc = ctypes.CDLL(None, use_errno=True)


def tun(namespace: str, own: str, peer: str) -> int:
    """The device's file descriptor; its interface lives in the namespace."""
    here, there = os.open("/proc/self/ns/net", os.O_RDONLY), os.open(f"/run/netns/{namespace}", os.O_RDONLY)
    _enter(there)
    device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH", b"radio", _TUN_NO_HEADER))
    _enter(here)
    for words in (f"addr add {own} peer {peer} dev radio", "link set radio mtu 1500 up"):
        subprocess.run(["ip", "-n", namespace, *words.split()], check=True)
    return device


def _enter(namespace: int) -> None:
    if _libc.setns(namespace, 0):
        raise OSError(ctypes.get_errno(), "setns")


class Way:
    """One direction: what is under way, and when the air is free again."""

    def __init__(self, into: int) -> None:
        self.into = into
        self.carried: dict[str, list[int]] = {}
        """By the port of the end that listens: packets and bytes."""
        self._free_s = self._last_s = 0.0
        self._under_way: list[tuple[float, int, bytes]] = []
        self._n = 0

    def take(self, packet: bytes, now_s: float, how: dict[str, float]) -> None:
        """Lose it, or let it arrive later, in order."""
        per_byte_s = 8e-6 / how["rate_Mbit_s"] if how["rate_Mbit_s"] else 0.0
        queued = (self._free_s - now_s) / per_byte_s if per_byte_s else 0.0
        port = self._count(packet)
        if how["down"] or port == how["deaf_port"] or random.random() < how["loss"] or queued > BUFFER_bytes:
            return
        self._free_s = max(self._free_s, now_s) + len(packet) * per_byte_s
        delay_s = max(0.0, random.gauss(how["delay_ms"], how["jitter_ms"])) * 1e-3
        self._last_s = max(self._last_s, self._free_s + delay_s)
        self._n += 1
        heapq.heappush(self._under_way, (self._last_s, self._n, packet))

    def _count(self, packet: bytes) -> int:
        """Of IPv4 over UDP or TCP; who knocks has the higher port."""
        start = 4 * (packet[0] & 0xF)
        ends = struct.unpack_from("!HH", packet, start) if len(packet) >= start + 4 else (0,)
        counted = self.carried.setdefault(str(min(ends)), [0, 0])
        counted[0] += 1
        counted[1] += len(packet)
        return min(ends)

    def deliver(self, now_s: float) -> float:
        """What is due; returns when something is next."""
        while self._under_way and self._under_way[0][0] <= now_s:
            with suppress(OSError):
                os.write(self.into, heapq.heappop(self._under_way)[2])
        return self._under_way[0][0] if self._under_way else now_s + 0.1


def carry(a: int, b: int) -> None:
    """Until standard input ends."""
    how: dict[str, float] = {
        "delay_ms": 0.0,
        "jitter_ms": 0.0,
        "loss": 0.0,
        "rate_Mbit_s": 0.0,
        "down": False,
        "deaf_port": 0,
    }
    ways = {a: Way(b), b: Way(a)}
    while True:
        now_s = time.monotonic()
        wait_s = min(way.deliver(now_s) for way in ways.values()) - now_s
        ready, _, _ = select.select([a, b, 0], [], [], max(0.0, wait_s))
        if 0 in ready:
            line = sys.stdin.readline()
            if not line:
                return
            how |= json.loads(line)
            print(json.dumps({"up": ways[a].carried, "down": ways[b].carried}), flush=True)
        for device in ready:
            if device in ways:
                with suppress(BlockingIOError):
                    for _ in range(64):
                        ways[device].take(os.read(device, 65_536), time.monotonic(), how)


def main() -> None:
    """As the module says."""
    a, b = (tun(ns, ADDRESS[x], ADDRESS[y]) for ns, x, y in zip(sys.argv[1:], "ab", "ba", strict=True))
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))  # hardware: nothing goes before it
    print("ready", flush=True)
    carry(a, b)


if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).parent)
    main()
