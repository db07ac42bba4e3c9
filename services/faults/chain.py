"""The whole system on virtual time: every service on the memory bus, the vehicle in process, nothing else replaced."""

import asyncio
import contextlib
import importlib
from collections import defaultdict
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from dataclasses import dataclass, field
from typing import Any

from schemas.safety import Action, OperatorRequest, Phase, SafetyState
from schemas.topics import BY_KEY, OPERATOR, REQUEST, SAFETY_STATE, TOPICS
from services.config import Config
from services.faults.direct_vehicle import DirectVehicle
from services.faults.meddled_bus import MeddledBus
from services.faults.stoppable import StoppableNode
from services.px4_bridge import service as bridge
from services.runtime.node import Node
from services.runtime.virtual import VirtualClock, run_virtual
from services.simulator import service as simulator

MAVLINK_DELAY_S = 0.003
ON_THE_BUS_ONLY = ("tracker", "force_estimator", "guiding_controller", "safety_supervisor")


@dataclass(repr=False)  # a loop that ends prints its result when a signal handler is reset
class Flight:
    """What was said on the bus, by topic, and the vehicle that flew."""

    config: Config
    vehicle: DirectVehicle
    said: dict[str, list[Any]] = field(default_factory=lambda: defaultdict(list))

    def hear(self, key: str, payload: bytes) -> None:
        """Keep what is a message of the topic."""
        with contextlib.suppress(ValueError):
            self.said[key].append(BY_KEY[key].type.model_validate_json(payload))

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

    bus: MeddledBus
    flight: Flight
    tasks: dict[str, asyncio.Task[None]]
    operator: Node
    nodes: dict[str, StoppableNode] = field(default_factory=dict[str, StoppableNode])
    begin: Callable[[str], None] = lambda name: None
    """Start a service (again)."""

    @property
    def now_s(self) -> float:
        """Virtual time."""
        return self.operator.clock.now_ns() * 1e-9

    def kill(self, name: str) -> None:
        """What kill -9 does: no service ends by itself after that."""
        self.tasks.pop(name).cancel()

    def stop(self, name: str) -> None:
        """What SIGSTOP does."""
        self.nodes[name].going.clear()
        if name == "px4_bridge":
            self.flight.vehicle.going.clear()

    def go_on(self, name: str) -> None:
        """What SIGCONT does."""
        self.nodes[name].going.set()
        if name == "px4_bridge":
            self.flight.vehicle.going.set()

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


Script = Callable[[Stage], Awaitable[object]]


def fly(config: Config, script: Script, limit_s: float = 200.0, configs: Mapping[str, Config] | None = None) -> Flight:
    """Start every service, run `script` (a coroutine function), stop; what was said meanwhile.

    `configs` gives a service another configuration than the rest: a world that is not as it is believed to be.
    """
    return run_virtual(_fly(config, script, configs), limit_s=limit_s)


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


async def _fly(config: Config, script: Script, configs: Mapping[str, Config] | None) -> Flight:
    clock, bus = VirtualClock(), MeddledBus()
    vehicle = DirectVehicle(config.px4_bridge.vehicle, clock.now_ns, MAVLINK_DELAY_S)
    flight = Flight(config, vehicle)
    for topic in TOPICS:
        bus.subscribe(topic.key, flight.hear)
    tasks: dict[str, asyncio.Task[None]] = {}
    nodes: dict[str, StoppableNode] = {}

    def begin(name: str) -> None:
        node = nodes[name] = StoppableNode(name, bus, clock)
        tasks[name] = asyncio.create_task(_run(name, node, (configs or {}).get(name, config), vehicle), name=name)

    for name in ("simulator", "px4_bridge", *ON_THE_BUS_ONLY):
        begin(name)
    try:
        await script(Stage(bus, flight, tasks, Node(OPERATOR, bus, clock, observer=True), nodes, begin))
    finally:
        for task in tasks.values():
            task.cancel()
        await asyncio.gather(*tasks.values(), return_exceptions=True)
    return flight


def _run(name: str, node: Node, config: Config, vehicle: DirectVehicle) -> Coroutine[Any, Any, None]:
    """The service as the launcher runs it, but for the wire between autopilot and bridge."""
    match name:
        case "simulator":
            return simulator.play(node, config, vehicle)
        case "px4_bridge":
            return bridge.fly(node, config, vehicle)
        case _:
            return importlib.import_module(f"services.{name}.service").run(node, config)
