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

from schemas.safety import Action, Level, Phase
from schemas.topics import HEALTH, SAFETY_STATE, SETPOINT, TRUTH, VEHICLE_STATE
from schemas.vehicle import SetpointKind
from services.config import Config, load
from services.console.operator import Operator, operator_node
from services.console.start import bus_config
from services.rehearsal.quick import quicker
from services.runtime.clock import MonotonicClock
from services.runtime.launcher import Launched, launch
from services.runtime.node import Node
from services.runtime.zenoh_bus import open_bus
from tests.processes import host
from tests.processes.window import Window
from tests.system.demo_profile import free_port

T = TypeVar("T")

HEARD = (SAFETY_STATE, SETPOINT, TRUTH, VEHICLE_STATE, HEALTH["recorder"])
CLEW = (sys.executable, "-P", "-m", "services.console.cli")
LOOK_S, NOTE_S, PATIENCE_S, STEADY_S, PULLS_N = 0.05, 0.1, 40.0, 0.5, 0.6


@dataclass
class System:
    """What flies, and what is heard of it."""

    config: Config
    launched: Launched
    commands: dict[str, list[str]]
    operator: Operator
    heard: dict[str, list[Any]] = field(default_factory=lambda: {t.key: [] for t in HEARD})
    _again: list[str] = field(default_factory=list[str])

    @property
    def phase(self) -> Phase:
        """By the supervisor's last word."""
        states = self.heard[SAFETY_STATE.key]
        return states[-1].phase if states else Phase.IDLE

    @property
    def height_m(self) -> float:
        """Of the vehicle, as it is."""
        return self.heard[TRUTH.key][-1].robot_position_m.z

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
        window = Window(self.heard, time.monotonic(), waits=[(time.monotonic(), host.waited_s(pids))])
        noting = asyncio.create_task(_note(window, pids))
        try:
            yield window
        finally:
            noting.cancel()
            window.end_s = time.monotonic()

    async def until(self, shown: Callable[[], bool], what: str, patience_s: float = PATIENCE_S) -> None:
        """Wait; raises AssertionError with `what` did not come and what limited the system."""
        deadline_s = time.monotonic() + patience_s
        while not shown():
            states = self.heard[SAFETY_STATE.key]
            assert time.monotonic() < deadline_s, f"never {what}: {states[-1] if states else 'no word'}"
            await asyncio.sleep(LOOK_S)

    async def reach(self, phase: Phase) -> None:
        """Start, and wait for a phase."""
        while self.phase is Phase.IDLE:
            await self.operator.ask(Action.START, 1.0)
            await asyncio.sleep(0.1)
        await self.until(lambda: self.phase is phase, str(phase))

    async def guided(self) -> None:
        """Start, and wait until the person is pulled along."""
        await self.reach(Phase.GUIDING)
        await self.pulled()

    async def pulled(self) -> None:
        """Wait until the person is pulled along."""
        await self.until(lambda: self.pulls, "pulled")

    async def landed(self) -> None:
        """Wait until the vehicle stands on the floor, whoever brought it there."""
        await self.until(lambda: self.height_m < 0.1, "on the floor")

    async def put_down(self) -> None:
        """Wait until it is down and disarmed, and the supervisor knows it."""
        await self.landed()
        await self.until(lambda: self.disarmed, "disarmed")
        await self.until(lambda: self.phase is Phase.LANDED, "told as landed")

    async def until_accepted(self, action: Action) -> None:
        """Ask until the supervisor does it."""
        async with asyncio.timeout(PATIENCE_S):
            reply = None
            while reply is None or not reply.accepted:
                reply = await self.operator.ask(action, 1.0)

    async def clew(self, *words: str) -> tuple[int, str]:
        """A command from another shell: its exit code, and what it says."""
        profile = str(Path(self.config.session_dir, "config.json"))
        process = await asyncio.create_subprocess_exec(
            *CLEW, *words, "--profile", profile, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
        )
        said, _ = await process.communicate()
        return process.returncode or 0, said.decode()

    @property
    def disarmed(self) -> bool:
        """By the bridge's last word, if that is new."""
        state = self.heard[VEHICLE_STATE.key][-1]
        return not state.armed and time.monotonic() - state.stamp_ns * 1e-9 < STEADY_S

    @property
    def pulls(self) -> bool:
        """Whether the person has been pulled along for a while, with nothing above a warning."""
        last = Window(self.heard, time.monotonic() - STEADY_S)
        sent = last.all(SETPOINT)
        guided = all(m.kind is SetpointKind.ADMITTANCE and m.u_A_N.x > PULLS_N for _, m in sent)
        easy = max(last.levels(), default=Level.EASE) < Level.EASE
        return self.phase is Phase.GUIDING and len(sent) > 10 and guided and easy


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
            system = System(config, launched, commands, Operator(node))
            listening = [asyncio.create_task(_hear(node, system, topic)) for topic in HEARD]
            try:
                return await script(system)
            finally:
                system.end_restarted()
                for task in listening:
                    task.cancel()
                await asyncio.gather(*listening, return_exceptions=True)


async def _note(window: Window, pids: list[int]) -> None:
    """What the host takes."""
    while True:
        await asyncio.sleep(NOTE_S)
        window.waits.append((time.monotonic(), host.waited_s(pids)))


async def _hear(node: Node, system: System, topic: Any) -> None:
    async for message in node.stream(topic, depth=1024):
        system.heard[topic.key].append(message)


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


def walk(folder: Path) -> Config:
    """The demo in a hurry until guiding; then the paper's path, with a person who is patient when the pull stops."""
    config, port = load("demo"), free_port()
    quick = quicker(config)
    link = replace(config.px4_bridge.link, url=f"udpin://127.0.0.1:{port}")
    patient = replace(quick.person.subject, let_go_after_s=60.0)
    return quick.model_copy(
        update={
            "path": config.path,
            "person": replace(quick.person, subject=patient),
            "system": replace(config.system, name=f"p{os.getpid()}"),
            "px4_bridge": replace(config.px4_bridge, link=link),
            "simulator": replace(quick.simulator, companion=f"127.0.0.1:{port}"),
            "session_dir": str(folder),
        }
    )
