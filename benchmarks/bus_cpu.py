"""What the bus costs: processor time of a writer and of a reader process, all their threads, as a share of one core.

- idle: a node that ticks at 100 Hz on a bus where nobody talks.
- latest: 250 + 125 + 100 + 100 + 60 messages a second, read through Latest by a node that ticks at 100 Hz.
- stream: 250 messages a second, each of which wakes an `async for`.
- record: the traffic of `latest`, kept whole by the recorder.

Processor time, not wall time: other load on the machine disturbs it little. `python -m benchmarks.bus_cpu`
"""

import asyncio
import json
import sys
import tempfile
import time
from collections.abc import Callable, Coroutine, Sequence
from pathlib import Path
from typing import Any

from benchmarks.table import show
from schemas.estimation import CableForce, Tare
from schemas.guidance import GuidanceCommand
from schemas.message import Message, Quaternion, Vec3
from schemas.topics import (
    CABLE_FORCE,
    GUIDANCE,
    HANDLE_STATE,
    SERVICES,
    SETPOINT,
    VEHICLE_IMU,
    VEHICLE_STATE,
    Topic,
)
from schemas.tracking import HandleSource, HandleState
from schemas.vehicle import FlightMode, Setpoint, SetpointKind, ThrustSource, VehicleImu, VehicleState
from services.config import load
from services.recorder.service import record
from services.runtime.bus_config import BusConfig
from services.runtime.clock import MonotonicClock
from services.runtime.node import Node, used
from services.runtime.zenoh_bus import ZenohBus, open_bus

COLUMNS = ("case", "writer CPU %", "reader CPU %", "messages seen /s", "sent /s")
CASES = ("idle", "latest", "stream", "record")

_WRITER_RATE_Hz, _READER_RATE_Hz = 250.0, 100.0
_SETTLE_s = 1.5

_V, _Q = Vec3(x=1 / 7, y=1 / 11, z=1 / 13), Quaternion(w=1 / 3, x=1 / 7, y=1 / 11, z=1 / 13)
_INPUTS = {"handle/state": 1234, "robot/pose": 1234, "vehicle/imu": 12345}

_FORCE = CableForce(
    inputs=_INPUTS,
    force_N=_V,
    observed_N=_V,
    bias_N=_V,
    bias_change_N=1 / 7,
    taut=True,
    slack_m=1 / 11,
    tare=Tare.PASSED,
    tare_report="",
)
_SENT = Setpoint(
    inputs=_INPUTS,
    kind=SetpointKind.ADMITTANCE,
    position_m=_V,
    velocity_mps=_V,
    acceleration_mps2=_V,
    yaw_rad=0.0,
    u_R_mps2=_V,
    u_A_N=_V,
    feed_forward=1.0,
    age_s=1 / 7,
)
_GUIDED = GuidanceCommand(
    inputs=_INPUTS,
    s=1 / 7,
    path_length_m=10 / 7,
    p_H_d_m=_V,
    p_R_d_m=_V,
    f_d_N=_V,
    scale=1.0,
    u_A_N=_V,
    path_error_m=1 / 7,
)
_VEHICLE = VehicleState(
    connected=True,
    armed=True,
    in_air=True,
    mode=FlightMode.OFFBOARD,
    position_m=_V,
    velocity_mps=_V,
    q_WB_wxyz=_Q,
    battery_fraction=0.9,
)
_HANDLE = HandleState(inputs=_INPUTS, position_m=_V, velocity_mps=_V, source=HandleSource.MOCAP, lag_s=0.02)
_IMU = VehicleImu(
    specific_force_B_mps2=_V,
    angular_rate_B_rad_s=_V,
    q_WB_wxyz=_Q,
    thrust_N=10 / 7,
    thrust_source=ThrustSource.ACTUATOR_OUTPUTS,
)

Traffic = tuple[tuple[Topic[Any], Message, float], ...]
_FLIGHT: Traffic = (
    (CABLE_FORCE, _FORCE, 250.0),
    (SETPOINT, _SENT, 125.0),
    (GUIDANCE, _GUIDED, 100.0),
    (VEHICLE_STATE, _VEHICLE, 100.0),
    (HANDLE_STATE, _HANDLE, 60.0),
)
TRAFFIC: dict[str, Traffic] = {
    "idle": (),
    "latest": _FLIGHT,
    "stream": ((VEHICLE_IMU, _IMU, 250.0),),
    "record": _FLIGHT,
}


def run(seconds: float = 8.0) -> list[tuple[str, ...]]:
    """Rows under COLUMNS."""
    return [asyncio.run(_case(case, seconds)) for case in CASES]


async def _case(case: str, seconds: float) -> tuple[str, ...]:
    with tempfile.TemporaryDirectory() as run_dir:
        writer, reader = await asyncio.gather(*(_process(role, case, run_dir, seconds) for role in ("write", "read")))
    figures = f"{100 * writer['cpu']:.1f}", f"{100 * reader['cpu']:.1f}", f"{reader['count']:.0f}"
    return (case, *figures, f"{writer['count']:.0f}")


async def _process(role: str, case: str, run_dir: str, seconds: float) -> dict[str, float]:
    arguments = ("-m", "benchmarks.bus_cpu", role, case, run_dir, str(seconds))
    process = await asyncio.create_subprocess_exec(sys.executable, *arguments, stdout=asyncio.subprocess.PIPE)
    out, _ = await process.communicate()
    return json.loads(out)


async def act(role: str, case: str, run_dir: str, seconds: float) -> None:
    """One of the two processes; prints its share of a core and how many messages it had in a second."""
    config = BusConfig(system="bench", run_dir=run_dir, services=SERVICES)
    with open_bus(config, "px4_bridge" if role == "write" else "recorder") as bus:
        count = [0]
        body = _write(bus, TRAFFIC[case], count) if role == "write" else _READERS[case](bus, count, run_dir)
        task = asyncio.create_task(body)
        await asyncio.sleep(_SETTLE_s)
        print(json.dumps(await _measure(count, seconds)), flush=True)
        await asyncio.sleep(_SETTLE_s / 2)  # the other one measures still
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def _measure(count: Sequence[int], seconds: float) -> dict[str, float]:
    before = time.monotonic(), time.process_time(), count[0]
    await asyncio.sleep(seconds)
    wall, cpu, seen = (
        new - old for new, old in zip((time.monotonic(), time.process_time(), count[0]), before, strict=True)
    )
    return {"cpu": cpu / wall, "count": seen / wall}


async def _write(bus: ZenohBus, traffic: Traffic, count: list[int]) -> None:
    senders = [
        (Node(topic.publisher, bus, MonotonicClock()).publisher(topic), message, rate_Hz)
        for topic, message, rate_Hz in traffic
    ]
    async for tick in Node("bench", bus, MonotonicClock()).ticks(_WRITER_RATE_Hz):
        for sender, message, rate_Hz in senders:
            share = rate_Hz / _WRITER_RATE_Hz
            if int((tick.n + 1) * share) > int(tick.n * share):
                sender.publish(message)
                count[0] += 1


async def _read_latest(bus: ZenohBus, count: list[int], run_dir: str) -> None:
    node = Node("safety_supervisor", bus, MonotonicClock())
    readers = [node.latest(topic) for topic, _, _ in _FLIGHT]
    async for _ in node.ticks(_READER_RATE_Hz):
        for reader in readers:  # about as often as the supervisor looks
            _ = reader.value, reader.message, reader.age_s
        used(*readers)
        count[0] = sum(node.received.values())


async def _read_stream(bus: ZenohBus, count: list[int], run_dir: str) -> None:
    node = Node("force_estimator", bus, MonotonicClock())
    async for _ in node.stream(VEHICLE_IMU):
        count[0] += 1


async def _idle(bus: ZenohBus, count: list[int], run_dir: str) -> None:
    async for _ in Node("safety_supervisor", bus, MonotonicClock()).ticks(_READER_RATE_Hz):
        pass


async def _record(bus: ZenohBus, count: list[int], run_dir: str) -> None:
    node, file = Node("recorder", bus, MonotonicClock()), Path(run_dir, "session.mcap")
    params = load("demo").recorder
    await record(node, bus, file=file, params=params, metadata={}, attachments={})


_READERS: dict[str, Callable[[ZenohBus, list[int], str], Coroutine[Any, Any, None]]] = {
    "idle": _idle,
    "latest": _read_latest,
    "stream": _read_stream,
    "record": _record,
}

if __name__ == "__main__":
    if len(sys.argv) == 5:
        asyncio.run(act(sys.argv[1], sys.argv[2], sys.argv[3], float(sys.argv[4])))
    else:
        show(run(), COLUMNS)
