"""The system in real time, every service a process, flown to where it is to be broken, and broken as often as it recovers."""

import asyncio
import os
import signal
import sys
import time
from collections.abc import AsyncGenerator, Callable, Coroutine
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import pytest

from services.config import Config, load
from services.console.operator import Operator, operator_node
from services.console.start import bus_config
from services.rehearsal.quick import quicker
from services.runtime.clock import MonotonicClock
from services.runtime.launcher import Launched, launch
from services.runtime.zenoh_bus import open_bus
from tests.net.two_hosts import CLEW
from tests.processes import host
from tests.processes.watched import HEARD, Watched, listening
from tests.processes.window import Window
from tests.system.demo_profile import free_port

T = TypeVar("T")

NOTE_S = 0.1


@dataclass(kw_only=True)
class System(Watched):
    """What flies, and what is heard of it."""

    config: Config
    launched: Launched
    commands: dict[str, list[str]]
    _again: list[str] = field(default_factory=list[str])

    def pid(self, name: str) -> int:
        """Of a service."""
        return self.launched.processes[name].pid

    def send(self, name: str, number: int) -> None:
        """A signal to a service."""
        self.launched.processes[name].send_signal(number)

    def ended(self, name: str) -> int | None:
        """The exit code of a service that has ended."""
        return self.launched.processes[name].returncode

    async def start_again(self, name: str) -> None:
        """As it was started; the launcher will not stop it a second time."""
        self._again.append(name)
        await self.launched.start(name, self.commands[name], _environment())

    def end_restarted(self) -> None:
        """Those that the launcher has given up."""
        for name in self._again:
            if self.ended(name) is None:
                self.send(name, signal.SIGKILL)

    @asynccontextmanager
    async def broken(self, *names: str) -> AsyncGenerator[Window]:
        """What follows from here on; the services that are broken are none that could have been quicker."""
        pids = [self.pid(name) for name in self.config.system.services if name not in (*names, "recorder")]
        with self.window() as window:
            noting = asyncio.create_task(_note(window, pids))
            try:
                yield window
            finally:
                noting.cancel()

    async def clew(self, *words: str) -> tuple[int, str]:
        """A command from another shell: its exit code, and what it says."""
        profile = str(Path(self.config.session_dir, "config.json"))
        process = await asyncio.create_subprocess_exec(
            *CLEW, *words, "--profile", profile, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
        )
        said, _ = await process.communicate()
        return process.returncode or 0, said.decode()


def fly(
    folder: Path, script: Callable[[System], Coroutine[Any, Any, T]], change: Callable[[Config], Config] | None = None
) -> T:
    """Start everything, do what `script` says, end everything; what it returns."""
    with pytest.MonkeyPatch.context() as patch, host.real_time(host.TEST):
        patch.setenv("CLEW_RUN_DIR", str(folder / "run"))
        config = walk(folder)
        return asyncio.run(_fly(change(config) if change else config, script))


async def _fly(config: Config, script: Callable[[System], Coroutine[Any, Any, T]]) -> T:
    buses, folder = bus_config(config), Path(config.session_dir)
    (folder / "config.json").write_text(config.model_dump_json())
    commands = {name: command(name, folder / "config.json") for name in config.system.services}
    with open_bus(buses, f"operator-{os.getpid()}") as bus:
        node = operator_node(bus, MonotonicClock())
        async with launch(commands, buses, folder / "logs", 60.0) as launched:
            system = System(operator=Operator(node), config=config, launched=launched, commands=commands)
            async with listening(node, system.heard, HEARD):
                try:
                    return await script(system)
                finally:
                    system.end_restarted()


async def _note(window: Window, pids: list[int]) -> None:
    """What the host takes."""
    waits = host.Waits(pids)
    while True:
        window.waits.append((time.monotonic(), waits.in_all_s()))
        await asyncio.sleep(NOTE_S)


def command(name: str, profile: Path) -> list[str]:
    """A service that can be made ill. The loops have priority, as those that hold the hand have where they are deployed."""
    return [
        *host.first(loop=name != "recorder"),
        sys.executable,
        "-P",
        "-m",
        "tests.processes.sick",
        "run",
        "--profile",
        str(profile),
        name,
    ]


def _environment() -> dict[str, str]:
    return {**os.environ, "CLEW_DIE_WITH_PARENT": str(os.getpid())}


def patient(config: Config) -> Config:
    """In a hurry until guiding; then the profile's own path, with a person who is patient when the pull stops."""
    quick = quicker(config)
    subject = replace(quick.person.subject, let_go_after_s=60.0)
    return quick.model_copy(update={"path": config.path, "person": replace(quick.person, subject=subject)})


def walk(folder: Path) -> Config:
    """The demo, patiently, under a name and on a port of its own."""
    config, port = patient(load("demo")), free_port()
    link = replace(config.px4_bridge.link, url=f"udpin://127.0.0.1:{port}")
    return config.model_copy(
        update={
            "system": replace(config.system, name=f"p{os.getpid()}"),
            "px4_bridge": replace(config.px4_bridge, link=link),
            "simulator": replace(config.simulator, companion=f"127.0.0.1:{port}"),
            "session_dir": str(folder),
        }
    )
