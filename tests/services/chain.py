"""The whole system on virtual time: every service on the memory bus, the vehicle in process, nothing else replaced."""

import asyncio
import importlib
from collections import defaultdict
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeAlias

from schemas.energy import EnergyBalance
from schemas.safety import Action, OperatorRequest, Phase, SafetyState
from schemas.topics import ENERGY, OPERATOR, REQUEST, SAFETY_STATE, TOPICS
from services.config import Config
from services.px4_bridge import service as bridge
from services.recorder import service as recorder
from services.recorder.origin import origin
from services.recorder.walk import CONFIG_ATTACHMENT
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node
from services.runtime.virtual import VirtualClock, run_virtual
from services.simulator import service as simulator
from tests.services.direct_vehicle import DirectVehicle

ROUNDING_J = 1e-9
MAVLINK_DELAY_S = 0.003
Runs: TypeAlias = dict[str, Coroutine[Any, Any, None]]
ON_THE_BUS_ONLY = ("tracker", "force_estimator", "guiding_controller", "safety_supervisor")


@dataclass(repr=False)  # a loop that ends prints its result when a signal handler is reset
class Flight:
    """What was said on the bus, by topic, and the vehicle that flew."""

    config: Config
    vehicle: Any
    said: dict[str, list[Any]] = field(default_factory=lambda: defaultdict(list))

    def phases(self) -> list[Phase]:
        """Each phase once, in order."""
        states = [m for m in self.said[SAFETY_STATE.key] if isinstance(m, SafetyState)]
        return [
            m.phase
            for before, m in zip([None, *states], states, strict=False)
            if before is None or before.phase is not m.phase
        ]

    def during(self, key: str, *phases: Phase) -> list[Any]:
        """Messages of a topic whose stamp lies in one of the phases."""
        states = [m for m in self.said[SAFETY_STATE.key] if isinstance(m, SafetyState) and m.phase in phases]
        spans = [(m.stamp_ns, m.stamp_ns + 10_000_000) for m in states]
        if not spans:
            return []
        return [m for m in self.said[key] if spans[0][0] <= m.stamp_ns <= spans[-1][1]]


@dataclass(repr=False)
class Stage:
    """A running system that a test can disturb."""

    bus: MemoryBus
    flight: Flight
    tasks: dict[str, asyncio.Task[None]]
    operator: Node

    def ask(self, action: Action, number: int = 1) -> None:
        """Send one request."""
        request = OperatorRequest(action=action, operator="test", request_id=number)
        self.operator.publisher(REQUEST).publish(request)

    async def until(self, condition: Callable[[SafetyState], bool], limit_s: float) -> SafetyState:
        """Wait for a verdict of the supervisor that fulfils `condition`; TimeoutError after `limit_s` virtual seconds."""
        async with asyncio.timeout(limit_s):
            async for state in self.operator.stream(SAFETY_STATE):
                for task in self.tasks.values():
                    if task.done():
                        task.result()
                if condition(state):
                    return state
        raise AssertionError


def fly(
    config: Config, script: Callable[[Stage], Awaitable[object]], limit_s: float = 200.0, record: Path | None = None
) -> Flight:
    """Start every service, run `script` (a coroutine function), stop; what was said meanwhile, also in a recording.

    Whatever the script broke, the filter must have been passive at its port throughout.
    """

    async def flight() -> Flight:
        clock, bus = VirtualClock(), MemoryBus()
        vehicle = DirectVehicle(config.px4_bridge.vehicle, clock.now_ns, MAVLINK_DELAY_S)
        runs: Runs = {
            "simulator": simulator.play(Node("simulator", bus, clock), config, vehicle),
            "px4_bridge": bridge.fly(Node("px4_bridge", bus, clock), config, vehicle),
        }
        if record:
            runs["recorder"] = _recorder(Node("recorder", bus, clock), config, record)
        return await perform(config, script, bus, clock, vehicle, runs)

    flown = run_virtual(flight(), limit_s=limit_s)
    check_balance(flown.said[ENERGY.key])
    return flown


def _recorder(node: Node, config: Config, file: Path) -> Coroutine[Any, Any, None]:
    return recorder.record(
        node,
        node.bus,
        file=file,
        params=config.recorder,
        metadata=origin(config),
        attachments={CONFIG_ATTACHMENT: config.model_dump_json().encode()},
    )


def check_balance(books: list[EnergyBalance]) -> None:
    """The balance of services/px4_bridge/energy.py to its stated error: rounding, on the side of energy made."""
    residual = [0.0, *(m.residual_J for m in books)]
    assert all(m.created_J <= ROUNDING_J for m in books), "the filter made energy"
    assert all(b >= a - ROUNDING_J for a, b in pairwise(residual)), "the residual fell"
    assert all(m.tank_J >= 0.0 for m in books)
    for m in books:
        supplied = m.handed_J + m.guidance_J + m.height_J + m.cable_J
        assert abs(m.stored_J + m.dissipated_J + m.residual_J - supplied) < ROUNDING_J


async def whole(stage: Stage) -> None:
    """The experiment from start to landing."""
    await asyncio.sleep(0.5)
    stage.ask(Action.START)
    await stage.until(lambda state: state.phase is Phase.LANDED, 150.0)


async def until_guiding(stage: Stage, for_s: float = 0.0) -> None:
    """Take-off, zeroing, the handle taken, and `for_s` of the guided walk."""
    await asyncio.sleep(0.5)
    stage.ask(Action.START)
    await stage.until(lambda state: state.phase is Phase.GUIDING, 60.0)
    await asyncio.sleep(for_s)


async def perform(
    config: Config,
    script: Callable[[Stage], Awaitable[object]],
    bus: MemoryBus,
    clock: VirtualClock,
    vehicle: Any,
    runs: Runs,
    others: Sequence[str] = ON_THE_BUS_ONLY,
) -> Flight:
    """The other services beside those in `runs`, while the script lasts."""
    flight, runs = Flight(config, vehicle), dict(runs)
    for topic in TOPICS:
        bus.subscribe(
            topic.key, lambda key, payload, t=topic: flight.said[key].append(t.type.model_validate_json(payload))
        )
    for name in others:
        runs[name] = importlib.import_module(f"services.{name}.service").run(Node(name, bus, clock), config)
    tasks = {name: asyncio.create_task(run, name=name) for name, run in runs.items()}
    try:
        await script(Stage(bus, flight, tasks, Node(OPERATOR, bus, clock, observer=True)))
    finally:
        for task in tasks.values():
            task.cancel()
        await asyncio.gather(*tasks.values(), return_exceptions=True)
    return flight
