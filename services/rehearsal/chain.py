"""The whole system on virtual time: every service on the memory bus, the vehicle in process, nothing else replaced."""

import asyncio
import contextlib
import importlib
from collections import defaultdict
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeAlias

from schemas.safety import Action, OperatorRequest, Phase, SafetyState
from schemas.topics import BY_KEY, OPERATOR, REQUEST, SAFETY_STATE, TOPICS
from services.config import Config
from services.px4_bridge import service as bridge
from services.recorder import service as recorder
from services.recorder.origin import origin
from services.recorder.walk import CONFIG_ATTACHMENT
from services.rehearsal.direct_vehicle import DirectVehicle
from services.rehearsal.meddled_bus import MeddledBus
from services.rehearsal.stoppable import StoppableNode
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node
from services.runtime.virtual import VirtualClock, run_virtual
from services.simulator import service as simulator
from services.simulator.human import Behaviour

MAVLINK_DELAY_S = 0.003
ON_THE_BUS_ONLY = ("tracker", "force_estimator", "guiding_controller", "safety_supervisor")
Run: TypeAlias = Callable[[Node], Coroutine[Any, Any, None]]
Runs: TypeAlias = dict[str, Run]
"""How each service is run on its node; again where it is restarted."""


class Said(Mapping[str, list[Any]]):
    """What was said on the bus, by topic; read when somebody asks for it, which for most topics nobody does."""

    def __init__(self) -> None:
        self._heard: defaultdict[str, list[bytes]] = defaultdict(list)
        self._read: defaultdict[str, list[Any]] = defaultdict(list)

    def hear(self, key: str, payload: bytes) -> None:
        """Keep it."""
        self._heard[key].append(payload)

    def read(self, keys: Iterable[str]) -> None:
        """Now, what somebody will ask for later."""
        for key in keys:
            self[key]

    def __getitem__(self, key: str) -> list[Any]:
        """All that is a message of the topic."""
        heard = self._heard[key]
        for payload in heard:
            with contextlib.suppress(ValueError):
                self._read[key].append(BY_KEY[key].type.model_validate_json(payload))
        heard.clear()
        return self._read[key]

    def __iter__(self) -> Iterator[str]:
        """Of the topics of which anything was heard."""
        return iter(tuple(self._heard))

    def __len__(self) -> int:
        """So many topics."""
        return len(self._heard)


@dataclass(repr=False)  # a loop that ends prints its result when a signal handler is reset
class Flight:
    """What was said on the bus, by topic, and the vehicle that flew."""

    config: Config
    vehicle: Any
    said: Said = field(default_factory=Said)

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
    """A running system that a script can disturb."""

    bus: Any
    flight: Flight
    tasks: dict[str, asyncio.Task[None]]
    operator: Node
    nodes: dict[str, StoppableNode] = field(default_factory=dict[str, StoppableNode])
    begin: Callable[[str], None] = lambda name: None
    """Start a service (again)."""
    behave: Callable[[Behaviour], None] = lambda deeds: None
    """What the person will do, from the moment in which they hold the handle."""
    catch: Callable[[float], None] = lambda by_m: None
    """The cable becomes shorter by so many m."""

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
            self.flight.vehicle.stop()

    def go_on(self, name: str) -> None:
        """What SIGCONT does."""
        self.nodes[name].going.set()
        if name == "px4_bridge":
            self.flight.vehicle.go_on()

    def ask(self, action: Action, number: int = 1) -> None:
        """Send one request."""
        request = OperatorRequest(action=action, operator="script", request_id=number)
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


Script: TypeAlias = Callable[[Stage], Awaitable[object]]


class Fly(Protocol):
    """A flight of the whole system, on the stand-in or on PX4."""

    def __call__(self, config: Config, script: Script, *, configs: Mapping[str, Config] | None = None) -> Flight:
        """As `fly` below."""
        ...


def fly(
    config: Config,
    script: Script,
    limit_s: float = 200.0,
    record: Path | None = None,
    configs: Mapping[str, Config] | None = None,
) -> Flight:
    """Start every service, run `script` (a coroutine function), stop; what was said meanwhile, also in a recording.

    `configs` gives a service another configuration than the rest: a world that is not as it is believed to be.
    """

    async def flight() -> Flight:
        clock, bus = VirtualClock(), MeddledBus()
        vehicle = DirectVehicle(config.px4_bridge.vehicle, clock.now_ns, MAVLINK_DELAY_S)
        its_own = dict(configs or {})
        world = simulator.standing_in(its_own.get("simulator", config), vehicle)
        runs: Runs = {
            "simulator": lambda node: simulator.act(node, world),
            "px4_bridge": lambda node: bridge.fly(node, its_own.get("px4_bridge", config), vehicle.met_anew()),
        }
        if record:
            runs["recorder"] = _recording(config, record)

        async def with_a_person(stage: Stage) -> None:
            stage.behave, stage.catch = world.behave, world.catch
            await script(stage)

        return await perform(config, with_a_person, bus, clock, vehicle, runs)

    return run_virtual(flight(), limit_s=limit_s)


async def perform(
    config: Config,
    script: Script,
    bus: MemoryBus,
    clock: VirtualClock,
    vehicle: Any,
    runs: Runs,
    others: Sequence[str] = ON_THE_BUS_ONLY,
) -> Flight:
    """The other services beside those in `runs`, while the script lasts."""
    flight, runs = Flight(config, vehicle), runs | {name: _as_launched(name, config) for name in others}
    for topic in TOPICS:
        bus.subscribe(topic.key, flight.said.hear)
    tasks: dict[str, asyncio.Task[None]] = {}
    nodes: dict[str, StoppableNode] = {}

    def begin(name: str) -> None:
        nodes[name] = StoppableNode(name, bus, clock)
        tasks[name] = asyncio.create_task(runs[name](nodes[name]), name=name)

    for name in runs:
        begin(name)
    try:
        await script(Stage(bus, flight, tasks, Node(OPERATOR, bus, clock, observer=True), nodes, begin))
    finally:
        for task in tasks.values():
            task.cancel()
        await asyncio.gather(*tasks.values(), return_exceptions=True)
    return flight


def _as_launched(name: str, config: Config) -> Run:
    """The service as the launcher runs it."""
    return lambda node: importlib.import_module(f"services.{name}.service").run(node, config)


def _recording(config: Config, file: Path) -> Run:
    return lambda node: recorder.record(
        node,
        node.bus,
        file=file,
        params=config.recorder,
        metadata=origin(config),
        attachments={CONFIG_ATTACHMENT: config.model_dump_json().encode()},
    )


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
