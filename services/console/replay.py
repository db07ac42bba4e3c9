"""`clew replay`: a recording onto a bus of its own, where nobody can take it for the living system.

The system is called `replay`, so no key of it is a key of one that flies; only tools look into it (`--replay`). It does not
start while the bridge to a vehicle runs on this host, and ends when one starts.
"""

import asyncio
import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from schemas.topics import BY_KEY
from services.recorder.reading import Session
from services.runtime.bus_config import AlreadyRunning, BusConfig, default_run_dir
from services.runtime.zenoh_bus import ZenohBus, open_bus
from services.session_files import complain, session_file

SYSTEM, PLAYER, BRIDGE = "replay", "player", "px4_bridge"
_LINK_S = 0.3
_LOOK_S = 0.5
_SLICE_s = 0.005


class VehicleConnected(RuntimeError):
    """A bridge to a vehicle runs on this host."""


def replay_bus_config() -> BusConfig:
    """Where a replay is heard; it has one publisher."""
    return BusConfig(system=SYSTEM, run_dir=default_run_dir(), services=(PLAYER,))


def command(given: Path, speed: float, start_s: float) -> int:
    """Play until the end or Ctrl-C. Returns 0, 1 where a vehicle is connected or another replay runs, 2 for bad input."""
    try:
        if not 0.0 < speed <= 1000.0:
            raise ValueError(f"--speed {speed:g}: must be above 0 and at most 1000")
        session = Session(session_file(given))
        if not 0.0 <= start_s <= session.duration_s:
            raise ValueError(f"--start {start_s:g}: the session lasts {session.duration_s:.1f} s")
    except (OSError, ValueError) as error:
        return complain(error)
    try:
        refuse_beside_a_vehicle(Path(default_run_dir()))
        with open_bus(replay_bus_config(), PLAYER) as bus:
            print(f"replaying {session.file} at {speed:g}x in the system {SYSTEM}; look with --replay, Ctrl-C stops")  # noqa: T201
            asyncio.run(play(session, bus, speed, start_s))
    except (VehicleConnected, AlreadyRunning) as error:
        complain(error)
        return 1
    except KeyboardInterrupt:
        return 0
    return 0


async def play(session: Session, bus: ZenohBus, speed: float, start_s: float = 0.0) -> None:
    """Say everything again at its time.

    Raises VehicleConnected as soon as a bridge starts on this host.
    """
    run_dir, looked = Path(default_run_dir()), 0.0
    await asyncio.sleep(_LINK_S)
    began = time.monotonic()
    for t_s, key, payload in spoken(session):
        if t_s < start_s:
            continue
        due = began + (t_s - start_s) / speed
        if (wait := due - time.monotonic()) > _SLICE_s:  # what is due within a slice is said together
            await asyncio.sleep(wait)
        if time.monotonic() - looked > _LOOK_S:
            looked = time.monotonic()
            refuse_beside_a_vehicle(run_dir)
        bus.put(key, payload, BY_KEY[key].stance)
    await asyncio.sleep(_LINK_S)


def spoken(session: Session) -> Iterator[tuple[float, str, bytes]]:
    """Everything in the order of its time: s since the session's start, topic, bytes."""
    logs = session.logs_of(key for key in session.keys if key in BY_KEY)
    said = [(time_ns, key, i) for key, log in logs.items() for i, time_ns in enumerate(log.times_ns)]
    for time_ns, key, i in sorted(said):
        yield (time_ns - session.start_ns) * 1e-9, key, logs[key].payloads[i]


def refuse_beside_a_vehicle(run_dir: Path) -> None:
    """Whatever the system is called: no replay while a bridge to a vehicle is alive.

    Raises:
        VehicleConnected: naming the system.
    """
    for lock in run_dir.glob(f"*/{BRIDGE}.pid"):
        if _held(lock):
            raise VehicleConnected(f"system {lock.parent.name} is connected to a vehicle: no replay beside it")


def _held(lock: Path) -> bool:
    """Whether a living process holds the name; see bus_config.claim."""
    with suppress(OSError):
        fd = os.open(lock, os.O_RDWR)
        try:
            fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        finally:
            os.close(fd)
    return False
