"""Where the services of one system find each other on one host: a folder of unix sockets, one for each service."""

import fcntl
import os
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import field
from pathlib import Path
from typing import Any, Protocol

from services.parameters import parameters
from services.runtime.hosts import Placement

_SOCKET_PATH_MAX_bytes = 107  # sun_path holds 108 with the final zero


class LogReader(Protocol):
    """Who reads along what Zenoh logs."""

    levels: str
    """What shall be logged, in the terms of RUST_LOG, which goes before it."""

    def note(self, line: str) -> bool:
        """Look at a line, without colours, in a thread of its own; returns whether it shall be printed."""
        ...


@parameters
class BusConfig:
    """One system (a drone with its ground station) on one host, as one process sees it.

    `endpoints` and `listen` are Zenoh's, beyond the host, and `settings` what else this process's session needs to own
    a radio link or to come in over one (gateway/session.py).
    """

    system: str
    run_dir: str
    services: tuple[str, ...]
    endpoints: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    settings: dict[str, Any] = field(default_factory=dict[str, Any])
    log: LogReader | None = None
    placement: Placement = Placement()

    @property
    def prefix(self) -> str:
        """In front of every key; `@v1` is matched only by itself, so versions cannot mix."""
        return f"clew/@v1/{self.system}/"

    def socket(self, name: str) -> Path:
        """Where `name` listens.

        Raises:
            ValueError: the path is longer than the kernel's limit for unix sockets.
        """
        path = Path(self.run_dir, self.system, f"{name}.sock")
        size = len(os.fsencode(path))
        if size > _SOCKET_PATH_MAX_bytes:
            raise ValueError(f"run_dir: socket path {path} has {size} bytes, the limit is {_SOCKET_PATH_MAX_bytes}")
        return path


class AlreadyRunning(RuntimeError):
    """A living process holds the name."""


def default_run_dir() -> str:
    """$CLEW_RUN_DIR, or $XDG_RUNTIME_DIR/clew, or /tmp/clew-<uid>."""
    if own := os.environ.get("CLEW_RUN_DIR"):
        return own
    session = os.environ.get("XDG_RUNTIME_DIR")
    return f"{session}/clew" if session else f"/tmp/clew-{os.getuid()}"


@contextmanager
def claim(config: BusConfig, name: str) -> Generator[None]:
    """Hold the name of a service; what a dead process of that name left behind is removed.

    Raises:
        AlreadyRunning: a living process holds it.
        PermissionError: the folder belongs to somebody else.
    """
    path = config.socket(name)
    _private_folder(path.parent)
    lock = os.open(path.with_suffix(".pid"), os.O_RDWR | os.O_CREAT, 0o600)
    try:
        _lock(lock, f"service {name} of system {config.system}")
        path.unlink(missing_ok=True)
        yield
        path.unlink(missing_ok=True)
    finally:
        os.close(lock)  # the kernel does as much for a process that is killed


def _private_folder(folder: Path) -> None:
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    owner = folder.stat().st_uid
    if owner != os.getuid():
        raise PermissionError(f"run_dir: {folder} belongs to user {owner}, not to {os.getuid()}")
    folder.chmod(0o700)


def _lock(fd: int, who: str) -> None:
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise AlreadyRunning(f"{who} is already running (pid {os.read(fd, 20).decode()})") from None
    os.ftruncate(fd, 0)
    os.write(fd, str(os.getpid()).encode())
