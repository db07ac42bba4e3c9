"""The two-host profile on virtual time: a bus and a clock for each host, and a radio between them that delays and fails."""

import asyncio
import importlib
import json
import random
from collections.abc import Callable, Coroutine
from dataclasses import replace
from pathlib import Path
from typing import Any

from schemas.topics import OPERATOR, TOPICS, Topic
from services.config import Config, load
from services.gateway.service import Comparison
from services.px4_bridge import service as bridge
from services.recorder import service as recorder
from services.recorder.walk import CONFIG_ATTACHMENT
from services.rehearsal.chain import MAVLINK_DELAY_S, ON_THE_BUS_ONLY, Flight, Stage
from services.rehearsal.direct_vehicle import DirectVehicle
from services.rehearsal.quick import quicker
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node
from services.runtime.virtual import VirtualClock, run_virtual
from services.simulator import service as simulator

LEAD_ns = 5_000_000_000_000
ONE_WAY_S = 0.002, 0.03


class AheadClock(VirtualClock):
    """The drone's."""

    def now_ns(self) -> int:
        return super().now_ns() + LEAD_ns


def time_of_day_ns() -> int:
    """Both hosts agree on it."""
    return VirtualClock().now_ns()


class Radio:
    """Carries what a host says to the other, late, thinned as the table has it, in order for each topic."""

    log = None

    def __init__(self, buses: dict[str, MemoryBus], config: Config, one_way_s: tuple[float, float] = ONE_WAY_S) -> None:
        self.down = False
        self._one_way_s = one_way_s
        self._random = random.Random(7)
        self._due_s: dict[str, float] = {}
        self._passed_s: dict[str, float] = {}
        for topic in TOPICS:
            there = "drone" if config.host_of(topic.publisher) == "drone" else "ground"
            far = buses["ground" if there == "drone" else "drone"]
            buses[there].subscribe(topic.key, lambda _, payload, t=topic, far=far: self._carry(t, payload, far))

    def _carry(self, topic: Topic[Any], payload: bytes, far: MemoryBus) -> None:
        loop = asyncio.get_running_loop()
        now_s, passed_s = loop.time(), self._passed_s.get(topic.key, -1.0)
        if self.down or (topic.radio_Hz and now_s - passed_s < 1.0 / topic.radio_Hz):
            return
        self._passed_s[topic.key] = now_s
        self._due_s[topic.key] = max(now_s + self._way_s(), self._due_s.get(topic.key, 0.0))
        loop.call_at(self._due_s[topic.key], far.put, topic.key, payload, topic.stance)

    def _way_s(self) -> float:
        return self._random.uniform(*self._one_way_s)

    def ask(self, key: str, on_reply: Callable[[bytes, int], None], timeout_s: float) -> None:
        """As the gateway's bus, from the drone."""
        loop, there_s, back_s = asyncio.get_running_loop(), self._way_s(), self._way_s()

        def answer() -> None:
            reply = json.dumps([VirtualClock().now_ns(), time_of_day_ns()]).encode()
            loop.call_later(back_s, lambda: on_reply(reply, AheadClock().now_ns()))

        if not self.down:
            loop.call_later(there_s, answer)

    def answer(self, key: str, reply: Callable[[], bytes]) -> None:
        """Nobody asks the drone."""

    def remotes(self) -> dict[str, tuple[str, int]]:
        """Nobody is told."""
        return {}


def with_recorder_on(host: str, config: Config) -> Config:
    """The profile with its recorder there."""
    hosts = {
        name: replace(
            each, services=tuple(s for s in each.services if s != "recorder") + ("recorder",) * (name == host)
        )
        for name, each in config.hosts.items()
    }
    return config.model_copy(update={"hosts": hosts})


def hurried() -> Config:
    """The ground's profile with shorter waits, on the whole path."""
    profile = load("ground-sim")
    return quicker(profile).model_copy(update={"path": profile.path})


def fly(script: Callable[[Stage, Radio], Coroutine[Any, Any, object]], files: dict[str, Path]) -> Config:
    """Every service on its host while `script` lasts, and a recorder on each of those in `files`."""
    return fly_as(hurried(), script, files, ONE_WAY_S)


def fly_as(
    config: Config,
    script: Callable[[Stage, Radio], Coroutine[Any, Any, object]],
    files: dict[str, Path],
    one_way_s: tuple[float, float],
) -> Config:
    """The same by any profile of two hosts."""

    async def flight() -> None:
        buses = {"drone": MemoryBus(), "ground": MemoryBus()}
        clocks = {"drone": AheadClock(), "ground": VirtualClock()}
        radio = Radio(buses, config, one_way_s)

        def node(name: str, on: str = "") -> Node:
            host = on or config.host_of(name) or "ground"
            observer = name == OPERATOR
            return Node(name, buses[host], clocks[host], observer=observer, placement=config.placement(host))

        vehicle = DirectVehicle(config.px4_bridge.vehicle, clocks["drone"].now_ns, MAVLINK_DELAY_S)
        runs: dict[str, Coroutine[Any, Any, None]] = {
            "simulator": simulator.play(node("simulator"), config, vehicle),
            "px4_bridge": bridge.fly(node("px4_bridge"), config, vehicle),
            "drone_gateway": _compare(node("drone_gateway"), radio, config),
        }
        for host, file in files.items():
            runs[f"recorder on {host}"] = _record(node("recorder", host), with_recorder_on(host, config), file)
        for name in ON_THE_BUS_ONLY:
            runs[name] = importlib.import_module(f"services.{name}.service").run(node(name), config)
        tasks = {name: asyncio.create_task(run, name=name) for name, run in runs.items()}
        stage = Stage(buses["ground"], Flight(config, vehicle), tasks, node(OPERATOR))
        try:
            await script(stage, radio)
        finally:
            for task in tasks.values():
                task.cancel()
            await asyncio.gather(*tasks.values(), return_exceptions=True)

    run_virtual(flight(), limit_s=200.0)
    return config


async def _compare(node: Node, radio: Radio, config: Config) -> None:
    assert config.radio
    comparison = Comparison(node, radio, config.radio, time_of_day_ns)
    async for tick in node.ticks(10.0):
        comparison.turn(tick.n, 1)


async def _record(node: Node, config: Config, file: Path) -> None:
    attachments = {CONFIG_ATTACHMENT: config.model_dump_json().encode()}
    await recorder.record(node, node.bus, file=file, params=config.recorder, metadata={}, attachments=attachments)
