"""Capture systems for tests, as their clients see them on the network: a VRPN server, and Qualisys Track Manager.

Both speak the real protocol to the vendors' real clients: VRPN as its Format_Of_Protocol.txt describes it, QTM the RT
protocol 1.25 in little endian.
"""

import asyncio
import contextlib
import socket
import struct
from collections.abc import AsyncGenerator, Callable, Mapping
from contextlib import asynccontextmanager

Pose = tuple[float, float, float, float, float, float, float]
Poses = Callable[[int], Mapping[str, Pose | None]]
"""Of frame n: position in m and attitude, w first; None for a body that is not seen."""


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class _Knock(asyncio.DatagramProtocol):
    """A VRPN client says by UDP where it listens; the server connects to it there."""

    def __init__(self) -> None:
        self.clients: asyncio.Queue[tuple[str, int]] = asyncio.Queue()

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        host, port = data.rstrip(b"\0").split()
        self.clients.put_nowait((host.decode(), int(port)))


@asynccontextmanager
async def vrpn(port: int, poses: Poses, rate_Hz: float = 100.0) -> AsyncGenerator[None]:
    """While it lives; then its connections are closed."""
    loop = asyncio.get_running_loop()
    transport, knock = await loop.create_datagram_endpoint(_Knock, local_addr=("127.0.0.1", port))
    task = asyncio.create_task(_vrpn_clients(knock, poses, rate_Hz))
    try:
        yield
    finally:
        transport.close()
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def _vrpn_clients(knock: _Knock, poses: Poses, rate_Hz: float) -> None:
    while True:
        host, port = await knock.clients.get()
        with contextlib.suppress(OSError):
            reader, writer = await asyncio.open_connection(host, port)
            try:
                await _vrpn_talk(reader, writer, poses, rate_Hz)
            finally:
                writer.close()


async def _vrpn_talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, poses: Poses, rate_Hz: float) -> None:
    writer.write(b"vrpn: ver. 07.38  0".ljust(24, b"\0"))
    names = list(poses(0))
    for n, name in enumerate(names):
        writer.write(_vrpn_message(n, -1, _vrpn_text(name)))
    writer.write(_vrpn_message(0, -2, _vrpn_text("vrpn_Tracker Pos_Quat")))
    draining = asyncio.create_task(_drain(reader))
    try:
        for n in range(1_000_000):
            for name, pose in poses(n).items():
                if pose is not None:
                    x, y, z, q_w, q_x, q_y, q_z = pose
                    body = struct.pack(">ii7d", 0, 0, x, y, z, q_x, q_y, q_z, q_w)
                    writer.write(_vrpn_message(names.index(name), 0, body))
            await writer.drain()
            await asyncio.sleep(1.0 / rate_Hz)
    finally:
        draining.cancel()


async def _drain(reader: asyncio.StreamReader) -> None:
    while await reader.read(4096):
        pass


def _vrpn_text(text: str) -> bytes:
    return struct.pack(">i", len(text) + 1) + text.encode() + b"\0"


def _vrpn_message(sender: int, kind: int, payload: bytes) -> bytes:
    header = struct.pack(">iiiiii", 24 + len(payload), 0, 0, sender, kind, 0)
    return header + payload.ljust((len(payload) + 7) // 8 * 8, b"\0")


class Qtm:
    """Qualisys Track Manager; `silent` stops its frames, as a frozen program or a cut network does."""

    def __init__(self, poses: Poses, rate_Hz: float = 100.0) -> None:
        self.silent = self.mute = False
        self.frame = 0
        self._poses, self._rate_Hz = poses, rate_Hz
        self._tasks: set[asyncio.Task[None]] = set()

    @asynccontextmanager
    async def listening(self, port: int) -> AsyncGenerator[None]:
        """While it lives; then its connections are closed."""
        server = await asyncio.start_server(self._talk, "127.0.0.1", port)
        try:
            yield
        finally:
            server.close()
            for task in self._tasks:
                task.cancel()
            await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task
        self._tasks.add(task)
        with contextlib.suppress(asyncio.CancelledError, OSError, asyncio.IncompleteReadError):
            if not self.mute:
                writer.write(_qtm_packet(1, b"QTM RT Interface connected\0"))
            await self._answer(reader, writer)
        writer.close()

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while True:
            size, _ = struct.unpack("<II", await reader.readexactly(8))
            command = (await reader.readexactly(size - 8)).rstrip(b"\0").decode().lower()
            if self.mute:
                continue
            if command.startswith("version"):
                writer.write(_qtm_packet(1, b"Version set to 1.25\0"))
            elif command.startswith("getparameters"):
                bodies = "".join(f"<Body><Name>{name}</Name></Body>" for name in self._poses(0))
                described = f"<QTM_Parameters_Ver_1.25><The_6D>{bodies}</The_6D></QTM_Parameters_Ver_1.25>"
                writer.write(_qtm_packet(2, described.encode() + b"\0"))
            elif command.startswith("streamframes"):
                await self._stream(writer)

    async def _stream(self, writer: asyncio.StreamWriter) -> None:
        """Frames at exact times of QTM's own clock, which began at 0 with the first."""
        while True:
            self.frame += 1
            if not self.silent:
                writer.write(_qtm_frame(self.frame, round(1e6 * self.frame / self._rate_Hz), self._poses(self.frame)))
                await writer.drain()
            await asyncio.sleep(1.0 / self._rate_Hz)


def _qtm_packet(kind: int, payload: bytes) -> bytes:
    return struct.pack("<II", 8 + len(payload), kind) + payload


def _qtm_frame(n: int, stamp_us: int, poses: Mapping[str, Pose | None]) -> bytes:
    bodies = b"".join(_qtm_body(pose) for pose in poses.values())
    component = struct.pack("<ihh", len(poses), 0, 0) + bodies
    return _qtm_packet(3, struct.pack("<qII", stamp_us, n, 1) + struct.pack("<II", 8 + len(component), 5) + component)


def _qtm_body(pose: Pose | None) -> bytes:
    if pose is None:
        return struct.pack("<12f", *[float("nan")] * 12)
    x, y, z, q_w, q_x, q_y, q_z = pose
    columns = (
        (1 - 2 * (q_y**2 + q_z**2), 2 * (q_x * q_y + q_w * q_z), 2 * (q_x * q_z - q_w * q_y)),
        (2 * (q_x * q_y - q_w * q_z), 1 - 2 * (q_x**2 + q_z**2), 2 * (q_y * q_z + q_w * q_x)),
        (2 * (q_x * q_z + q_w * q_y), 2 * (q_y * q_z - q_w * q_x), 1 - 2 * (q_x**2 + q_y**2)),
    )
    return struct.pack("<12f", 1e3 * x, 1e3 * y, 1e3 * z, *(value for column in columns for value in column))
