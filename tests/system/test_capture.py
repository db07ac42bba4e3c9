"""Real clients of capture systems on servers that work, die, freeze, lie or are not there, in real time."""

import asyncio
import itertools
import math
import os
import signal
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from schemas.tracking import MocapFrame, StampedBy
from services.config import load
from services.console.preflight_ground import look_at_capture
from services.profile_file import ConfigError
from services.tracker.bodies import Body, CaptureSystem
from services.tracker.capture import Capture, check
from tests.system.capture_servers import Pose, Poses, Qtm, free_port, vrpn

pytest.importorskip("motioncapture", reason="motioncapture is not installed: it has no wheel for this machine")
YAWED = (math.cos(0.6), 0.0, 0.0, math.sin(0.6))


def moving(*names: str) -> Poses:
    """Bodies that move a little with every frame, a metre apart, turned to the left."""

    def poses(n: int) -> dict[str, Pose | None]:
        return {name: (1.0 * k, 1e-4 * (n % 100), 0.5, *YAWED) for k, name in enumerate(names)}

    return poses


class Follower:
    """A capture system followed by the code under test: what came, what was said, and whether its loop went on."""

    def __init__(self, source: str, port: int, restart_s: float = 1.0, handle: str = "handle", **settings: str):
        host = f"127.0.0.1:{port}" if source == "vrpn" else "127.0.0.1"
        if source == "qtm":
            settings = {"port": str(port)}
        self.frames: list[MocapFrame] = []
        self.told: list[str] = []
        self.longest_gap_s = 0.0
        p = CaptureSystem(
            host=host,
            robot=Body(body="robot", offset_m=(0.0, 0.1, 0.0)),
            handle=Body(body=handle),
            rate_min_Hz=50.0,
            rate_max_Hz=250.0,
            repeat_s=0.3,
            restart_s=restart_s,
            settings=settings,
        )
        self.capture = Capture(source, p)

    async def until(self, condition: Callable[[], bool], limit_s: float = 15.0) -> None:
        """Wait, and measure how long this loop was kept from running."""
        async with asyncio.timeout(limit_s):
            while not condition():
                before = time.monotonic()
                await asyncio.sleep(0.01)
                self.longest_gap_s = max(self.longest_gap_s, time.monotonic() - before)

    async def seen(self, more: int = 20) -> None:
        """Wait for so many more frames with both bodies."""
        had = len(self.frames)
        await self.until(lambda: sum(f.robot.tracked and f.handle.tracked for f in self.frames[had:]) >= more)

    def said(self, text: str) -> Callable[[], bool]:
        return lambda: any(text in told for told in self.told)


def following(follower: Follower, script: Callable[[], Awaitable[object]]) -> Follower:
    async def main() -> None:
        task = asyncio.create_task(follower.capture.follow(follower.frames.append, follower.told.append))
        try:
            await script()
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    asyncio.run(main())
    return follower


def test_what_is_not_installed_or_has_no_address_is_told_before_anything_starts(monkeypatch):
    p = CaptureSystem(
        host="no.such.host.invalid:3883",
        robot=Body(body="robot"),
        handle=Body(body="handle"),
        rate_min_Hz=50.0,
        rate_max_Hz=250.0,
        repeat_s=0.3,
        restart_s=1.0,
    )
    with pytest.raises(ConfigError, match=r"^tracker.mocap.host = no.such.host.invalid:3883: does not resolve: "):
        check("vrpn", p)
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(
        ConfigError, match=r"^tracker.source = qtm: needs the package qtm_rt: pip install 'clew-hri\[qualisys\]'"
    ):
        check("qtm", p)


def test_vrpn_gives_both_bodies_where_the_profile_wants_them_stamped_on_arrival():
    port = free_port()
    follower = Follower("vrpn", port)

    async def script():
        async with vrpn(port, moving("robot", "handle", "chair")):
            await follower.seen(50)

    following(follower, script)
    frame = follower.frames[-1]
    assert frame.stamped_by is StampedBy.ARRIVAL
    assert 0 <= time.monotonic_ns() - frame.stamp_ns < 5e9
    assert frame.handle.position_m.x == pytest.approx(1.0, abs=1e-6)
    assert (frame.handle.q_WB_wxyz.w, frame.handle.q_WB_wxyz.z) == pytest.approx((YAWED[0], YAWED[3]), abs=1e-6)
    # the offset is the body's, which is turned by 1.2 rad
    assert frame.robot.position_m.x == pytest.approx(-0.1 * math.sin(1.2), abs=1e-6)
    assert follower.capture.trouble == ""


def test_a_vrpn_server_that_dies_is_told_and_found_again():
    port = free_port()
    follower = Follower("vrpn", port)

    async def script():
        async with vrpn(port, moving("robot", "handle")):
            await follower.seen()
        await follower.until(follower.said("no frame from vrpn at 127.0.0.1"))
        await follower.until(follower.said("is it on, streaming, reachable?"))
        async with vrpn(port, moving("robot", "handle")):
            await follower.seen()

    following(follower, script)


def test_a_body_that_does_not_exist_is_named_with_those_that_do():
    port = free_port()
    follower = Follower("vrpn", port, handle="handel")
    trouble = f"no body handel in vrpn at 127.0.0.1:{port}; it has: handle, robot"

    async def script():
        async with vrpn(port, moving("robot", "handle")):
            await follower.until(lambda: follower.capture.trouble == trouble)

    following(follower, script)
    assert follower.frames[-1].robot.tracked
    assert not follower.frames[-1].handle.tracked


def test_a_pose_that_is_repeated_is_none():
    """The package's mock gives the same poses for ever, as some servers do for a body that is hidden."""
    follower = Follower("mock", 0, rigid_bodies="robot(1,2,3,1,0,0,0);handle(0,0,1,1,0,0,0)", frequency="100")

    async def script():
        await follower.seen(5)
        await follower.until(lambda: not follower.frames[-1].robot.tracked)

    following(follower, script)
    assert follower.capture.trouble == "handle and robot: the same pose for 0.3 s, to the last bit"
    first_hidden = next(f for f in follower.frames if not f.robot.tracked)
    assert first_hidden.stamp_ns - follower.frames[0].stamp_ns == pytest.approx(0.3e9, abs=0.1e9)


def test_a_client_that_never_returns_does_not_stop_the_loop():
    """With nobody there `connect` of OptiTrack's client keeps the interpreter to itself for ever."""
    follower = Follower("optitrack", 0, restart_s=0.5, port_command=str(free_port()))

    async def script():
        await follower.until(lambda: sum("is it on, streaming" in told for told in follower.told) >= 2)

    following(follower, script)
    assert follower.longest_gap_s < 0.4


def test_a_driver_that_is_killed_is_started_again():
    port = free_port()
    follower = Follower("vrpn", port)

    def drivers() -> list[int]:
        children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
        return [int(pid) for pid in children if b"tracker.driver" in Path(f"/proc/{pid}/cmdline").read_bytes()]

    async def script():
        async with vrpn(port, moving("robot", "handle")):
            await follower.seen()
            os.kill(drivers()[0], signal.SIGKILL)
            await follower.until(follower.said("the driver of vrpn ended (SIGKILL)"))
            await follower.seen()

    following(follower, script)
    assert drivers() == []


def test_qtm_stamps_its_frames_by_its_own_clock():
    pytest.importorskip("qtm_rt")
    port = free_port()
    follower, server = Follower("qtm", port), Qtm(moving("chair", "handle", "robot"))

    async def script():
        async with server.listening(port):
            await follower.seen(150)

    following(follower, script)
    frames = follower.frames[20:]
    assert {frame.stamped_by for frame in frames} == {StampedBy.SOURCE}
    steps_ms = [(b.stamp_ns - a.stamp_ns) * 1e-6 for a, b in itertools.pairwise(frames)]
    assert sorted(steps_ms)[len(steps_ms) // 2] == pytest.approx(10.0, abs=0.01)  # of QTM's clock, not of the network
    assert frames[-1].handle.q_WB_wxyz.z == pytest.approx(YAWED[3], abs=1e-5)
    assert frames[-1].handle.position_m.x == pytest.approx(1.0, abs=1e-6)
    assert frames[-1].robot.position_m.x == pytest.approx(2.0 - 0.1 * math.sin(1.2), abs=1e-5)


def test_qtm_hides_a_body_freezes_and_goes():
    pytest.importorskip("qtm_rt")
    port = free_port()
    hidden = False

    def poses(n: int) -> dict[str, Pose | None]:
        return {**moving("robot", "handle")(n), **({"handle": None} if hidden else {})}

    follower, server = Follower("qtm", port), Qtm(poses)

    async def script():
        nonlocal hidden
        await follower.until(follower.said(f"qtm at 127.0.0.1: no QTM answers on port {port}"))
        async with server.listening(port):
            await follower.seen()
            hidden = True
            await follower.until(lambda: not follower.frames[-1].handle.tracked)
            assert follower.frames[-1].robot.tracked
            hidden = False
            await follower.seen()
            server.silent = True
            await follower.until(follower.said("no frame from qtm at 127.0.0.1 for 1 s: is it on"))
            server.silent = False
            await follower.seen()
        await follower.until(follower.said("qtm at 127.0.0.1: QTM closed the connection"))

    following(follower, script)


def test_a_qtm_that_takes_the_call_and_says_nothing_is_told():
    pytest.importorskip("qtm_rt")
    port = free_port()
    follower, server = Follower("qtm", port), Qtm(moving("robot", "handle"))
    server.mute = True

    async def script():
        async with server.listening(port):
            await follower.until(follower.said("is it on, streaming, reachable?"))

    following(follower, script)


def test_preflight_looks_at_the_capture_system_itself(tmp_path):
    """A vehicle and a handle on the floor, by VRPN's real client; then a server whose y is up."""
    port = free_port()
    file = tmp_path / "bench.toml"
    file.write_text(
        'base = "ground-sim"\n[tracker]\nsource = "vrpn"\n'
        f'[tracker.mocap]\nhost = "127.0.0.1:{port}"\nrate_min_Hz = 50.0\nrate_max_Hz = 250.0\n'
        'repeat_s = 0.3\nrestart_s = 3.0\nrobot = {body = "robot"}\nhandle = {body = "handle"}\n'
    )
    config = load(str(file))

    def lying(n: int, *, y_up: bool = False) -> dict[str, Pose | None]:
        noise = 1e-5 * (n % 7)
        floor = {"robot": (-2.0, -0.5, 0.08 + noise), "handle": (-2.0, -0.9 + noise, 0.02)}
        turned = {name: (x, z, -y) if y_up else (x, y, z) for name, (x, y, z) in floor.items()}
        return {name: (*p, 1.0, 0.0, 0.0, 0.0) for name, p in turned.items()}

    async def listed(poses: Poses | None) -> list[str]:
        if poses is None:
            return [str(reason.what) for reason in await look_at_capture(config, 1.5, appears_s=1.0)]
        async with vrpn(port, poses):
            return [str(reason.what) for reason in await look_at_capture(config, 1.5)]

    assert asyncio.run(listed(lying)) == []
    (upright,) = asyncio.run(listed(lambda n: lying(n, y_up=True)))
    assert upright.startswith("the capture system's y axis is up: robot and handle lie still at y = 0.08 and 0.02 m")
    (silent,) = asyncio.run(listed(None))
    assert silent.startswith(f"no frame from vrpn at 127.0.0.1:{port} for ")
