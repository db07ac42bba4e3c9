"""The paper's rate: observer and admittance filter on a 1 kHz IMU, over Zenoh, beside the default 250 Hz.

The bridge's own loops run here with a made-up vehicle that delivers one inertial sample per millisecond; the force
estimator is its real process. What is measured: how old a sample is when the set-point that contains it leaves, how many
samples came back as forces, and how punctual the set-point loop is. `python -m benchmarks.kilohertz`
"""

import asyncio
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.table import quantile_ms, show
from schemas.message import Vec3
from schemas.safety import Level, Permit, Phase, SafetyState
from schemas.topics import CABLE_FORCE, SAFETY_STATE, SETPOINT, VEHICLE_IMU
from schemas.vehicle import FlightMode, ThrustSource
from services.config import Config, load
from services.console.start import bus_config
from services.physics import GRAVITY_MPS2, Array
from services.px4_bridge import service as bridge
from services.px4_bridge.telemetry import Checks, ImuSample, VehicleSample
from services.px4_bridge.thrust import Throttle
from services.runtime.clock import MonotonicClock
from services.runtime.launcher import launch
from services.runtime.node import Node
from services.runtime.zenoh_bus import open_bus

COLUMNS = (
    "IMU",
    "sample -> set-point p50 ms",
    "p99 ms",
    "samples",
    "forces back",
    "set-point loop late p50 ms",
    "p99 ms",
    "missed",
    "this process, % of a core",
)
WARM_UP_S, SECONDS = 2.0, 8.0
TOGETHER = ("px4_bridge", "force_estimator", "safety_supervisor", "simulator")
_HERE = np.array([-2.0, -0.5, 2.0])
_NOISE_MPS2 = 0.01  # what never changes counts as stuck
_STILL, _LEVEL = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])


class Hovering:
    """A vehicle that hovers for ever and delivers inertial samples at `rate_Hz`; what it is sent goes nowhere."""

    def __init__(self, node: Node, rate_Hz: float, hover_N: float) -> None:
        self._node, self._rate_Hz, self._hover_N = node, rate_Hz, hover_N
        self._arrived, self._waiting = asyncio.Event(), list[ImuSample]()
        self.samples = 0

    @property
    def sample(self) -> VehicleSample:
        now_ns = self._node.clock.now_ns()
        return VehicleSample(now_ns, True, True, True, FlightMode.OFFBOARD, True, _HERE, _STILL, _LEVEL, 1.0, 0.0)

    async def sense(self) -> None:
        async for tick in self._node.ticks(self._rate_Hz):
            self.samples += 1
            felt = np.array([0.0, 0.0, GRAVITY_MPS2 + _NOISE_MPS2 * np.sin(tick.n)])
            now_ns = self._node.clock.now_ns()
            source = ThrustSource.ACTUATOR_OUTPUTS
            self._waiting.append(ImuSample(now_ns, felt, _STILL, _LEVEL, self._hover_N, source, Throttle(0.5, 0.25)))
            self._arrived.set()

    async def wait_imu(self) -> None:
        await self._arrived.wait()

    def drain_imu(self) -> list[ImuSample]:
        self._arrived.clear()
        drained, self._waiting = self._waiting, []
        return drained

    def drain_texts(self) -> list[str]:
        return []

    def send_setpoint(self, p_W: Array | None, v_W: Array | None, a_W: Array | None, yaw_rad: float | None) -> None:
        pass

    def send_pose(self, p_W: Array, q_WB_wxyz: Array, stamp_ns: int) -> None:
        pass

    async def arm(self) -> None:
        pass

    disarm = kill = terminate = set_origin = ask_version = arm

    @property
    def checks(self) -> Checks:
        return Checks()

    async def arming_problems(self) -> list[str]:
        return []

    async def get_parameters(self) -> dict[str, int | float]:
        return {}

    async def set_mode(self, mode: FlightMode) -> None:
        pass

    async def get_parameter(self, name: str) -> int | float:
        return 0

    async def set_parameter(self, name: str, value: int | float) -> None:
        pass


@dataclass
class Probe:
    """What one run showed."""

    age_ns: list[int]
    samples: int
    forces: int
    late_ms: Callable[[float], float]
    missed: int
    cpu: float


def run(seconds: float = SECONDS) -> list[tuple[str, ...]]:
    """Rows under COLUMNS, for 250 Hz and 1 kHz."""
    with tempfile.TemporaryDirectory() as folder:
        config = load("demo", session_dir=folder)
        system = replace(config.system, name="bench_kilohertz", services=TOGETHER)  # beside a demo, undisturbed
        config = config.model_copy(update={"system": system})
        resolved = Path(folder, "config.json")
        resolved.write_text(config.model_dump_json())
        probes = [(rate, asyncio.run(_measure(config, resolved, rate, seconds))) for rate in (250.0, 1000.0)]
    return [_row(rate, probe) for rate, probe in probes]


async def _measure(config: Config, resolved: Path, rate_Hz: float, seconds: float) -> Probe:
    command = [sys.executable, "-P", "-m", "services.console.cli", "run", "--profile", str(resolved), "force_estimator"]
    async with launch({"force_estimator": command}, bus_config(config), resolved.parent):
        with open_bus(bus_config(config), "px4_bridge") as bus:
            return await _fly(Node("px4_bridge", bus, MonotonicClock()), config, rate_Hz, seconds)


async def _fly(node: Node, config: Config, rate_Hz: float, seconds: float) -> Probe:
    vehicle = Hovering(
        Node("simulator", node.bus, node.clock), rate_Hz, config.vehicle.quadrotor.mass_kg * GRAVITY_MPS2
    )
    watch = Node("probe", node.bus, node.clock, observer=True)
    imu, forces = watch.queue(VEHICLE_IMU, depth=4096), watch.queue(CABLE_FORCE, depth=4096)
    sent = watch.queue(SETPOINT, depth=4096)
    loops = [
        asyncio.create_task(loop)
        for loop in (
            vehicle.sense(),
            bridge.fly(node, config, vehicle),
            _permit(Node("safety_supervisor", node.bus, node.clock)),
        )
    ]
    try:
        await asyncio.sleep(WARM_UP_S)
        for stream in (imu, forces, sent):
            stream.drain()
        before, missed, cpu = vehicle.samples, node.stats.missed, time.process_time()
        ages: list[int] = []
        back = 0
        for _ in range(round(seconds * 2)):
            await asyncio.sleep(0.5)
            back += len(forces.drain())
            imu.drain()
            ages += [round(message.age_s * 1e9) for message in sent.drain()]
        used = (time.process_time() - cpu) / seconds
        return Probe(ages, vehicle.samples - before, back, node.stats.lateness_ms, node.stats.missed - missed, used)
    finally:
        for loop in loops:
            loop.cancel()
        await asyncio.gather(*loops, return_exceptions=True)


async def _permit(node: Node) -> None:
    """The supervisor's part: wait, anchored, so that the filter runs."""
    out = node.publisher(SAFETY_STATE)
    async for _ in node.ticks(SAFETY_STATE.rate_Hz):
        out.publish(
            SafetyState(
                phase=Phase.READY,
                level=Level.OK,
                permit=Permit.WAIT,
                goal_m=Vec3.of(_HERE),
                speed_mps=0.5,
                tare=False,
                held=False,
                reasons=[],
                stalls=0,
            )
        )


def _row(rate_Hz: float, p: Probe) -> tuple[str, ...]:
    return (
        f"{rate_Hz:.0f} Hz",
        f"{quantile_ms(p.age_ns, 0.5):.2f}",
        f"{quantile_ms(p.age_ns, 0.99):.2f}",
        str(p.samples),
        str(p.forces),
        f"{p.late_ms(0.5):.2f}",
        f"{p.late_ms(0.99):.2f}",
        str(p.missed),
        f"{100 * p.cpu:.0f}",
    )


if __name__ == "__main__":
    show(run(), COLUMNS)
