"""The whole system on real PX4, unthrottled: virtual time for the services, lockstep for PX4, nothing else replaced.

A session is recorded as in any flight, so it is read and judged by the same summary.
"""

import asyncio
from collections.abc import Mapping
from contextlib import closing

from schemas.safety import Action, Phase
from schemas.topics import SAFETY_STATE
from services.config import Config
from services.px4_bridge import service as bridge
from services.rehearsal.chain import ON_THE_BUS_ONLY, Flight, Runs, Script, Stage, perform
from services.rehearsal.ground_station import GroundStation
from services.rehearsal.meddled_bus import MeddledBus
from services.rehearsal.px4_vehicle import Px4Vehicle
from services.runtime.node import Node
from services.runtime.virtual import VirtualClock, run_virtual
from services.simulator import px4_process
from services.simulator import service as simulator
from services.simulator.px4_hil import Px4Hil
from services.simulator.px4_sitl import Px4Sitl
from services.simulator.stage import Stage as World


def fly(config: Config, script: Script, limit_s: float = 250.0, configs: Mapping[str, Config] | None = None) -> Flight:
    """As chain.fly, with PX4 started for it, and a recording in the session's folder.

    How PX4 is set is the world's: of the simulator's own configuration, where it has one. Raises Px4NotThere or Px4Lost.
    """
    world = (configs or {}).get("simulator", config)
    sitl, laboratory = world.simulator.px4_sitl, world.px4_bridge.px4
    assert sitl is not None, "the profile does not simulate with PX4"

    async def with_px4() -> Flight:
        async with px4_process.connected(sitl, config.vehicle, laboratory, config.session_dir) as hil:
            flight = _flight(config, script, hil, sitl, configs or {})
            return await asyncio.to_thread(run_virtual, flight, limit_s=limit_s)

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


async def _flight(config: Config, script: Script, hil: Px4Hil, sitl: Px4Sitl, configs: Mapping[str, Config]) -> Flight:
    clock, bus = VirtualClock(), MeddledBus()
    port = int(config.px4_bridge.link.url.rsplit(":", 1)[1])
    with (
        closing(GroundStation(sitl.station_port, sitl.system)) as station,
        closing(Px4Vehicle(config.px4_bridge.vehicle, clock.now_ns, hil, port, station, sitl.system)) as vehicle,
    ):
        world = World(configs.get("simulator", config), lambda _: vehicle)

        async def bridging(node: Node) -> None:
            await vehicle.ready()
            await bridge.fly(node, configs.get("px4_bridge", config), vehicle)

        async def with_a_person(stage: Stage) -> None:
            stage.behave, stage.catch = world.behave, world.catch
            await script(stage)

        runs: Runs = {"simulator": lambda node: simulator.act(node, world), "px4_bridge": bridging}
        return await perform(config, with_a_person, bus, clock, vehicle, runs, ("recorder", *ON_THE_BUS_ONLY))
