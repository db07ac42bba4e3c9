"""Bare UDP over the radio, beside which the age of guidance is shown: what the radio alone does to a packet of its size.

`python -m benchmarks.bare_datagrams hear SECONDS` prints the ages as JSON; `say ADDRESS SECONDS` sends, by the same clock.
"""

import asyncio
import json
import socket
import struct
import sys
import time

from services.runtime.clock import MonotonicClock
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node

PORT, RATE_Hz, SIZE_bytes = 7500, 100.0, 320


def hear(seconds: float) -> None:
    """Until then."""
    ages_s: list[float] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("", PORT))
        print("listening", flush=True)
        deadline_s = time.monotonic() + seconds
        while (left_s := deadline_s - time.monotonic()) > 0.0:
            ear.settimeout(left_s)
            try:
                packet = ear.recv(2048)
            except TimeoutError:
                break
            ages_s.append((time.monotonic_ns() - struct.unpack_from("q", packet)[0]) * 1e-9)
    print(json.dumps({"ages_s": ages_s}), flush=True)


async def say(address: str, seconds: float) -> None:
    """By the loop that a service has."""
    node = Node("voice", MemoryBus(), MonotonicClock(), observer=True)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mouth:
        async for tick in node.ticks(RATE_Hz):
            mouth.sendto(struct.pack("q", time.monotonic_ns()).ljust(SIZE_bytes, b"x"), (address, PORT))
            if tick.n >= seconds * RATE_Hz:
                return


if __name__ == "__main__":
    if sys.argv[1] == "hear":
        hear(float(sys.argv[2]))
    else:
        asyncio.run(say(sys.argv[2], float(sys.argv[3])))
