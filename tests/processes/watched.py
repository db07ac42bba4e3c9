"""What is heard of a flight in real time, and how a script waits for what it shows."""

import asyncio
import time
from collections.abc import AsyncGenerator, Callable, Generator, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from typing import Any

from schemas.safety import Action, Level, Phase
from schemas.topics import HEALTH, SAFETY_STATE, SETPOINT, TRUTH, VEHICLE_STATE, Topic
from schemas.vehicle import SetpointKind
from services.console.operator import Operator
from services.runtime.node import Node
from tests.processes.window import Window

HEARD = (SAFETY_STATE, SETPOINT, TRUTH, VEHICLE_STATE, HEALTH["recorder"])
LOOK_S, PATIENCE_S, STEADY_S, PULLS_N = 0.05, 40.0, 0.5, 0.6
EARLIER_S = 5.0


@dataclass(kw_only=True)
class Watched:
    """A flight as the bus tells it."""

    operator: Operator
    heard: dict[str, list[Any]] = field(default_factory=lambda: {t.key: [] for t in HEARD})

    @property
    def phase(self) -> Phase:
        """By the supervisor's last word."""
        states = self.heard[SAFETY_STATE.key]
        return states[-1].phase if states else Phase.IDLE

    @property
    def height_m(self) -> float:
        """Of the vehicle, as it is."""
        return self.heard[TRUTH.key][-1].robot_position_m.z

    @contextmanager
    def window(self) -> Generator[Window]:
        """What follows from here on, until it is left."""
        window = Window(self.heard, time.monotonic())
        try:
            yield window
        finally:
            window.end_s = time.monotonic()

    async def until(self, shown: Callable[[], bool], what: str, patience_s: float = PATIENCE_S) -> None:
        """Wait; raises AssertionError with what did not come, and what followed meanwhile and just before."""
        waited = Window(self.heard, time.monotonic() - EARLIER_S)
        while not shown():
            assert waited.age_s < EARLIER_S + patience_s, f"never {what}: {waited}"
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

    @property
    def disarmed(self) -> bool:
        """By the bridge's last word, if that is new and the autopilot's."""
        state = self.heard[VEHICLE_STATE.key][-1]
        return state.connected and not state.armed and time.monotonic() - state.stamp_ns * 1e-9 < STEADY_S

    @property
    def pulls(self) -> bool:
        """Whether the person has been pulled along for a while, by a cable that is taut, with nothing above a warning."""
        last = Window(self.heard, time.monotonic() - STEADY_S)
        sent = last.all(SETPOINT)
        guided = all(m.kind is SetpointKind.ADMITTANCE and m.u_A_N.x > PULLS_N for _, m in sent)
        easy = max(last.levels(), default=Level.EASE) < Level.EASE
        taut = last.pull_N(0.0) > PULLS_N
        return self.phase is Phase.GUIDING and len(sent) > 10 and guided and easy and taut


@asynccontextmanager
async def listening(node: Node, heard: dict[str, list[Any]], topics: Sequence[Topic[Any]]) -> AsyncGenerator[None]:
    """Note what is said of `topics`."""

    async def hear(topic: Topic[Any]) -> None:
        async for message in node.stream(topic, depth=1024):
            heard[topic.key].append(message)

    tasks = [asyncio.create_task(hear(topic)) for topic in topics]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
