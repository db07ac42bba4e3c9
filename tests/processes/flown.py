"""A flight in real time, every service a process, broken in guiding by what really breaks processes."""

import asyncio
import os
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from schemas.safety import Action, Phase
from schemas.topics import HEALTH, SAFETY_STATE, SETPOINT, TRUTH
from schemas.vehicle import SetpointKind
from services.config import Config
from services.console.operator import Operator, operator_node
from services.console.start import bus_config, launch_all
from services.rehearsal.quick import quick_config
from services.runtime.clock import MonotonicClock
from services.runtime.launcher import Launched
from services.runtime.node import Node
from services.runtime.zenoh_bus import open_bus
from tests.system.demo_profile import free_port

HEARD = (SAFETY_STATE, SETPOINT, TRUTH, HEALTH["recorder"])
SLACK = (SetpointKind.EASE, SetpointKind.HOLD)
Break = Callable[["Flown"], None]


@dataclass
class Flown:
    """A system in guiding, what was heard of it, and when it was broken (s on the host's clock)."""

    config: Config
    launched: Launched
    heard: dict[str, list[Any]] = field(default_factory=lambda: {t.key: [] for t in HEARD})
    broken_s: float = 0.0
    again: list[str] = field(default_factory=list)
    """Started a second time, which the launcher knows nothing of when it stops them."""

    def pid(self, name: str) -> int:
        return self.launched.processes[name].pid

    def signal(self, name: str, number: int) -> None:
        self.launched.processes[name].send_signal(number)

    def start_again(self, name: str) -> None:
        """As the launcher started it."""
        resolved = Path(self.config.session_dir) / "config.json"
        command = [sys.executable, "-P", "-m", "services.console.cli", "run", "--profile", str(resolved), name]
        env = {**os.environ, "CLEW_DIE_WITH_PARENT": str(os.getpid())}
        self.again.append(name)
        self._starting = asyncio.create_task(self.launched.start(name, command, env))

    def later(self, seconds: float, act: Callable[[], None]) -> None:
        asyncio.get_running_loop().call_later(seconds, act)

    def after(self, key: str) -> list[Any]:
        return [m for m in self.heard[key] if m.stamp_ns * 1e-9 > self.broken_s]

    def eased_after_s(self) -> float:
        """From the fault to the first set-point without a pull."""
        times = [m.stamp_ns * 1e-9 for m in self.after(SETPOINT.key) if m.kind in SLACK]
        return min(times, default=np.inf) - self.broken_s

    def silent_after_s(self) -> float:
        """From the fault to the last set-point."""
        return max([m.stamp_ns * 1e-9 - self.broken_s for m in self.after(SETPOINT.key)], default=0.0)

    def pull_N(self, begin_s: float = 0.0, end_s: float = np.inf) -> float:
        """The strongest pull of the cable on the hand between two times after the fault."""
        return max(
            (
                float(np.linalg.norm(m.cable_force_N.array()))
                for m in self.after(TRUTH.key)
                if m.holding and begin_s < m.stamp_ns * 1e-9 - self.broken_s < end_s
            ),
            default=0.0,
        )

    def commanded_N(self) -> float:
        return max((float(np.linalg.norm(m.u_A_N.array())) for m in self.after(SETPOINT.key)), default=0.0)


def fly(folder: Path, act: Break, watch_s: float, walk_s: float = 2.0) -> Flown:
    """Take off, be guided for `walk_s`, break, and watch for `watch_s`."""
    return asyncio.run(_fly(folder, act, watch_s, walk_s))


async def _fly(folder: Path, act: Break, watch_s: float, walk_s: float) -> Flown:
    config = _config(folder)
    with open_bus(bus_config(config), f"operator-{os.getpid()}") as bus:
        node = operator_node(bus, MonotonicClock())
        async with launch_all(config) as launched:
            flown = Flown(config, launched)
            listening = [asyncio.create_task(_hear(node, flown, topic)) for topic in HEARD]
            try:
                await _guiding(flown, Operator(node))
                await asyncio.sleep(walk_s)
                flown.broken_s = time.monotonic()
                act(flown)
                await asyncio.sleep(watch_s)
            finally:
                for name in flown.again:
                    flown.signal(name, signal.SIGKILL)
                for task in listening:
                    task.cancel()
                await asyncio.gather(*listening, return_exceptions=True)
            return flown


async def _hear(node: Node, flown: Flown, topic: Any) -> None:
    async for message in node.stream(topic, depth=1024):
        flown.heard[topic.key].append(message)


async def _guiding(flown: Flown, operator: Operator) -> None:
    states = flown.heard[SAFETY_STATE.key]
    async with asyncio.timeout(60.0):
        while not states or states[-1].phase is not Phase.GUIDING:
            if states and states[-1].phase is Phase.IDLE:
                await operator.ask(Action.START, 1.0)
            await asyncio.sleep(0.1)


def _config(folder: Path) -> Config:
    config, port = quick_config(), free_port()
    link = replace(config.px4_bridge.link, url=f"udpin://127.0.0.1:{port}")
    return config.model_copy(
        update={
            "system": replace(config.system, name=f"p{os.getpid()}"),
            "px4_bridge": replace(config.px4_bridge, link=link),
            "simulator": replace(config.simulator, companion=f"127.0.0.1:{port}"),
            "session_dir": str(folder),
        }
    )
