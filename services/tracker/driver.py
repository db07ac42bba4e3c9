# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportMissingImports=false, reportUnknownParameterType=false
"""A process of its own that speaks with a capture system and writes what it sees to its output, one line of JSON a frame.

It is a process because the vendors' code is: `motioncapture.connect` holds the interpreter's lock, and with Vicon and OptiTrack
it does not return while nobody answers, so in the tracker's process it would stop the tracker's heart. Nor can any thread be
ended that waits for a frame in there. A process can, and one that dies of a malformed packet takes nobody with it.
"""

import asyncio
import ctypes
import importlib
import os
import signal
import sys
from collections.abc import Callable, Mapping
from typing import Any, Protocol
from xml.etree import ElementTree

from pydantic_core import from_json, to_json

from services.runtime.clock import MonotonicClock
from services.tracker.bodies import LIBRARY, Pose, usable
from services.tracker.rotation import from_matrix

QTM_PORT = 22223
_PR_SET_PDEATHSIG = 1

Tell = Callable[[dict[str, Any]], None]


class _Body(Protocol):
    position: Any
    rotation: Any


def main() -> int:
    """`python -m services.tracker.driver SOURCE HOST SETTINGS`; ends with its parent. Exit code 1 after a fault was told."""
    source, host, settings = sys.argv[1], sys.argv[2], from_json(sys.argv[3])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to both
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    tell = _teller()
    try:
        if LIBRARY[source] == "qtm_rt":
            asyncio.run(_qtm(host, settings, tell))
        else:
            _motioncapture(source, host, settings, tell)
    except (RuntimeError, OSError, TimeoutError) as error:
        tell({"fault": " ".join(str(error).split()) or type(error).__name__})
    return 1


def _teller() -> Tell:
    """Lines go to what was the standard output; what the vendors' code prints itself goes to the log."""
    lines = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)
    return lambda message: (lines.write(to_json(message) + b"\n"), None)[1]


def _motioncapture(source: str, host: str, settings: Mapping[str, str], tell: Tell) -> None:
    """Frames as they come, stamped on arrival: the package has stamps, but does not hand them on to Python."""
    now_ns = MonotonicClock().now_ns
    system = importlib.import_module("motioncapture").connect(source, {**settings, "hostname": host})
    while True:
        system.waitForNextFrame()
        arrived_ns = now_ns()
        poses = {name: pose for name, body in system.rigidBodies.items() if usable(pose := _pose(body))}
        if poses or source != "vrpn":  # VRPN is polled: nothing new is no frame
            tell({"arrived_ns": arrived_ns, "poses": poses})


def _pose(body: _Body) -> Pose:
    x, y, z = map(float, body.position)
    q = body.rotation
    return (x, y, z, q.w, q.x, q.y, q.z)


async def _qtm(host: str, settings: Mapping[str, str], tell: Tell) -> None:
    """Frames with QTM's own time stamps, by Qualisys's package."""
    now_ns, qtm_rt = MonotonicClock().now_ns, importlib.import_module("qtm_rt")
    gone = asyncio.get_running_loop().create_future()
    port = int(settings.get("port", QTM_PORT))

    def left(_: object) -> None:
        if not gone.done():
            gone.set_result(None)

    async with asyncio.timeout(5.0):  # the package itself waits for ever for a first answer
        connection = await qtm_rt.connect(host, port=port, on_disconnect=left)
        if connection is None:
            raise RuntimeError(f"no QTM answers on port {port}")
        described = await connection.get_parameters(parameters=["6d"])
    names = [(name.text or "").strip() for name in ElementTree.fromstring(described).findall("*/Body/Name")]
    tell({"names": names})

    def frame(packet: Any) -> None:
        arrived_ns, (_, bodies) = now_ns(), packet.get_6d() or (None, [])
        poses = {name: pose for name, body in zip(names, bodies, strict=False) if usable(pose := _qtm_pose(*body))}
        tell({"arrived_ns": arrived_ns, "source_ns": 1000 * packet.timestamp, "poses": poses})

    await connection.stream_frames(components=["6d"], on_packet=frame)
    await gone
    raise RuntimeError("QTM closed the connection")


def _qtm_pose(position_mm: Any, rotation: Any) -> Pose:
    """From mm, and a rotation matrix by columns; NaN where the body is not seen."""
    columns = rotation.matrix
    w, x, y, z = from_matrix((columns[0::3], columns[1::3], columns[2::3]))
    return (position_mm.x / 1000, position_mm.y / 1000, position_mm.z / 1000, w, x, y, z)


if __name__ == "__main__":
    sys.exit(main())
