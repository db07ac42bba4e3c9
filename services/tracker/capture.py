"""A real capture system, followed by a process of its own (driver.py) that is started anew whenever it falls silent.

A server that dies, hangs or is cut off gives no error in any vendor's client, only silence. So silence is what is judged:
it is told after `SILENT_S`, and after `restart_s` the connection is made anew.
"""

import asyncio
import importlib.util
import signal
import socket
import sys
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any, NoReturn

from pydantic_core import from_json, to_json

from schemas.message import Quaternion, Vec3
from schemas.tracking import MocapFrame, RigidBody, StampedBy
from services.profile_file import ConfigError
from services.runtime.clock import Clock, MonotonicClock
from services.tracker import bodies, stamps
from services.tracker.bodies import LIBRARY, Body, CaptureSystem, Pose, Seen

SILENT_S = 0.5
NAMES_S = 2.0
"""After this long a body that has not been seen is missed by its name."""
_AGAIN_S = 1.0
_PACKAGE = {"motioncapture": "mocap", "qtm_rt": "qualisys"}


def check(source: str, p: CaptureSystem) -> None:
    """Whether its package is installed and its server has an address, before anything starts. Raises ConfigError."""
    package = LIBRARY[source]
    if importlib.util.find_spec(package) is None:
        extra = _PACKAGE[package]
        raise ConfigError(f"tracker.source = {source}: needs the package {package}: pip install 'clew-hri[{extra}]'")
    if source != "mock":
        _address(p.host)


def _address(host: str) -> str:
    """Of a name, and with its port: the vendors' clients take a name that does not resolve for a server that is silent."""
    name, _, port = host.partition(":")
    try:
        address = str(socket.getaddrinfo(name, None, socket.AF_INET, socket.SOCK_STREAM)[0][4][0])
    except OSError as error:
        raise ConfigError(f"tracker.mocap.host = {host}: does not resolve: {error.strerror or error}") from None
    return f"{address}:{port}" if port else address


class Capture:
    """Follows one capture system. `trouble` is why frames or bodies are missing, in words; empty when nothing is."""

    def __init__(self, source: str, p: CaptureSystem, clock: Clock | None = None) -> None:
        self.source, self.names = source, set[str]()
        self.trouble = f"waiting for {source} at {p.host}"
        self._p, self._now_ns = p, (clock or MonotonicClock()).now_ns
        self._wanted = frozenset((p.robot.body, p.handle.body))
        self._began_ns = 0
        self._stamps, self._waiting, self._repeats = stamps.State(), Seen(0, {}), dict[str, tuple[Pose, int]]()

    async def follow(
        self, take: Callable[[MocapFrame], None], tell: Callable[[str], None] = lambda _: None
    ) -> NoReturn:
        """Hand over each frame, and tell each trouble that keeps frames away, for ever."""
        while True:
            try:
                async with self._driver() as process:
                    why = await self._listen(process, take, tell)
            except ConfigError as error:  # its name does not resolve any more
                why = str(error)
            self._say(why, tell)
            await asyncio.sleep(_AGAIN_S)

    @asynccontextmanager
    async def _driver(self) -> AsyncGenerator[Process]:
        address = self._p.host if self.source == "mock" else _address(self._p.host)
        command = (sys.executable, "-P", "-m", "services.tracker.driver", self.source, address)
        settings = to_json(self._p.settings).decode()
        process = await asyncio.create_subprocess_exec(*command, settings, stdin=DEVNULL, stdout=PIPE)
        try:
            yield process
        finally:
            if process.returncode is None:
                process.kill()
            await process.wait()

    async def _listen(self, process: Process, take: Callable[[MocapFrame], None], tell: Callable[[str], None]) -> str:
        """Until the driver ends or has been silent for too long; returns why."""
        assert process.stdout
        self._began_ns, silent_s = self._now_ns(), 0.0
        line = asyncio.ensure_future(process.stdout.readline())
        try:
            while silent_s < self._p.restart_s:
                done, _ = await asyncio.wait({line}, timeout=SILENT_S)
                if not done:
                    silent_s += SILENT_S
                    self._say(f"no frame from {self.source} at {self._p.host} for {silent_s:g} s", tell)
                    continue
                said, silent_s = line.result(), 0.0
                if not said:
                    return await self._ended(process)
                message: dict[str, Any] = from_json(said)
                if "fault" in message:
                    return f"{self.source} at {self._p.host}: {message['fault']}"
                self._heard(message, take)
                line = asyncio.ensure_future(process.stdout.readline())
        finally:
            line.cancel()
        return f"no frame from {self.source} at {self._p.host} for {silent_s:g} s: is it on, streaming, reachable?"

    async def _ended(self, process: Process) -> str:
        code = await process.wait()
        how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return f"the driver of {self.source} ended ({how})"

    def _say(self, trouble: str, tell: Callable[[str], None]) -> None:
        self.trouble = trouble
        tell(trouble)

    def _heard(self, message: dict[str, Any], take: Callable[[MocapFrame], None]) -> None:
        if "names" in message:
            self.names = set(message["names"])
            return
        now = Seen(message["arrived_ns"], {name: tuple(pose) for name, pose in message["poses"].items()})
        self.names |= now.poses.keys()
        stamped_by = StampedBy.ARRIVAL
        if "source_ns" in message:
            self._stamps, stamped_by = stamps.step(self._stamps, message["source_ns"], now.stamp_ns), StampedBy.SOURCE
            now = now._replace(stamp_ns=self._stamps.stamp_ns)
        frames = [now]
        if self.source == "vrpn":
            self._waiting, frames = bodies.gather(self._waiting, now, self._wanted)
        for seen in frames:
            self._repeats, moving = bodies.unrepeated(self._repeats, seen, self._p.repeat_s)
            self.trouble = self._missing(seen, moving)
            take(self._frame(moving, stamped_by))

    def _missing(self, seen: Seen, moving: Seen) -> str:
        """Of the bodies: one that does not exist, or repeats itself."""
        if seen.stamp_ns - self._began_ns > NAMES_S * 1e9 and (absent := sorted(self._wanted - self.names)):
            there = ", ".join(sorted(self.names)) or "none"
            return f"no body {', '.join(absent)} in {self.source} at {self._p.host}; it has: {there}"
        frozen = sorted(self._wanted & seen.poses.keys() - moving.poses.keys())
        return f"{' and '.join(frozen)}: the same pose for {self._p.repeat_s:g} s, to the last bit" if frozen else ""

    def _frame(self, seen: Seen, stamped_by: StampedBy) -> MocapFrame:
        robot, handle = (_body(seen.poses.get(each.body), each) for each in (self._p.robot, self._p.handle))
        stamp: dict[str, Any] = {"stamp_ns": seen.stamp_ns, "stamped_by": stamped_by, "trouble": self.trouble}
        return MocapFrame(robot=robot, handle=handle, **stamp)


def _body(pose: Pose | None, body: Body) -> RigidBody:
    if pose is None:
        return RigidBody(tracked=False)
    p, q = bodies.placed(pose, body)
    return RigidBody(tracked=True, position_m=Vec3.of(p), q_WB_wxyz=Quaternion.of(q))
