"""The whole system on real PX4, unthrottled: virtual time for the services, lockstep for PX4, nothing else replaced.

A session is recorded as in any flight, so it is read and judged by the same summary.
"""

import asyncio
import os
from collections.abc import Awaitable, Callable
from pathlib import Path

from schemas.safety import Action, Phase
from schemas.topics import SAFETY_STATE
from services.config import Config, load
from services.px4_bridge import service as bridge
from services.rehearsal.chain import ON_THE_BUS_ONLY, Flight, Runs, Stage, perform
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node
from services.runtime.virtual import VirtualClock, run_virtual
from services.simulator import px4_process
from services.simulator import service as simulator
from services.simulator.px4_hil import Px4Hil
from services.simulator.stage import Stage as World
from tests.services.px4_vehicle import Px4Vehicle

PX4_BIN = os.environ.get("PX4_BIN", "")
Script = Callable[[Stage], Awaitable[object]]


def px4_config(folder: Path, seed: int = 1) -> Config:
    """The profile with PX4_BIN, its session in `folder`."""
    return load("px4-sitl", seed=seed, px4=PX4_BIN, session_dir=str(folder))


def fly(config: Config, script: Script, limit_s: float = 250.0) -> Flight:
    """As chain.fly, with PX4 started for it, and a recording in the session's folder."""
    sitl, laboratory = config.simulator.px4_sitl, config.px4_bridge.px4
    assert sitl is not None, "the profile does not simulate with PX4"

    async def with_px4() -> Flight:
        async with px4_process.connected(sitl, config.vehicle, laboratory, config.session_dir) as hil:
            return await asyncio.to_thread(run_virtual, _flight(config, script, hil), limit_s=limit_s)

    return asyncio.run(with_px4())


async def whole(stage: Stage) -> None:
    """The experiment from start to landing; PX4 is ready when it is ready."""
    await started(stage)
    await stage.until(lambda state: state.phase is Phase.LANDED, 150.0)
    await asyncio.sleep(1.0)


async def started(stage: Stage) -> None:
    """Ask until it takes off."""
    safety = stage.operator.latest(SAFETY_STATE)
    for n in range(1, 60):
        stage.ask(Action.START, n)
        await asyncio.sleep(0.5)
        if safety.message is not None and safety.message.phase is not Phase.IDLE:
            return
    raise AssertionError(f"does not start: {safety.message.reasons if safety.message else 'the supervisor is silent'}")


async def _flight(config: Config, script: Script, hil: Px4Hil) -> Flight:
    clock, bus = VirtualClock(), MemoryBus()
    port = int(config.px4_bridge.link.url.rsplit(":", 1)[1])
    vehicle = Px4Vehicle(config.px4_bridge.vehicle, clock.now_ns, hil, port)

    async def bridging(node: Node) -> None:
        await vehicle.ready()
        await bridge.fly(node, config, vehicle)

    runs: Runs = {
        "simulator": lambda node: simulator.act(node, World(config, lambda _: vehicle)),
        "px4_bridge": bridging,
    }
    try:
        return await perform(config, script, bus, clock, vehicle, runs, ("recorder", *ON_THE_BUS_ONLY))
    finally:
        vehicle.close()
