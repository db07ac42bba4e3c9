"""What the MAVLink border costs on both sides at the rates of a flight: percent of a core, microseconds per message.

The bridge's side (real MAVSDK) runs here, the vehicle's side in a process of its own, in real time. The bridge asks
for its rates itself, takes all inertial samples, and sends set-points and poses.
"""

import asyncio
import socket
import time
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np

from services.config import load, load_vehicle
from services.physics import GRAVITY_MPS2
from services.px4_bridge.vehicle import MavsdkVehicle
from services.simulator import autopilot
from services.simulator.autopilot import STEP_S, Autopilot, Output, Sensors
from services.simulator.commander import Commander
from services.simulator.estimator import Estimator
from services.simulator.mavlink import MavlinkLink

SECONDS = 10.0
SETPOINTS_HZ, POSES_HZ = 125.0, 62.5
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
SENSORS = Sensors(np.array([0.1, 0.2, GRAVITY_MPS2]), np.array([0.01, 0.02, 0.03]), LEVEL)
NOTHING = Output(np.zeros(4), (), ())
VEHICLE = load("demo").px4_bridge.vehicle
PARAMETERS = Autopilot(
    commander=Commander(check_period_s=0.02, loss_latency_s=0.3, proof_of_life_s=0.2),
    estimator=Estimator(bandwidth_rad_s=12.0, gate_m=0.2, rejection_s=1.5, dead_reckoning_s=4.7, delay_max_s=0.2),
    cascade=load_vehicle("light").cascade,
    idle_thrust=0.1,
    landed_thrust=0.5,
    landed_after_s=1.0,
    landed_speed_mps=0.2,
    risen_m=0.1,
    px4={
        "COM_OF_LOSS_T": 0.5,
        "COM_OBL_RC_ACT": 4,
        "COM_DISARM_LAND": 2,
        "COM_DISARM_PRFLT": 10,
        "COM_KILL_DISARM": 0,
        "COM_RC_IN_MODE": 4,
        "MPC_LAND_SPEED": 0.7,
    },
)


class Cost(NamedTuple):
    """CPU seconds of the link and of its whole process, messages in either direction, seconds of a set-point's call."""

    link_s: float
    process_s: float
    sent: int
    received: int
    call_s: float = 0.0


def play(port: int, conductor: Connection) -> None:
    """The vehicle's side in a process of its own; counts from the first word of the conductor to the second."""
    state = autopilot.initial(np.zeros(3), LEVEL, PARAMETERS)._replace(has_position=True)
    received, began, link_s, process_s, sent = 0, time.monotonic(), 0.0, 0.0, 0
    with MavlinkLink(("127.0.0.1", port)) as link:
        for n in range(1, 100_000):
            state = state._replace(t_s=n * STEP_S)
            entered = time.thread_time()
            received += len(link.receive())
            link.send(state, SENSORS, NOTHING)
            link_s += time.thread_time() - entered
            if conductor.poll():
                if conductor.recv() == "stop":
                    break
                link_s, process_s, sent, received = 0.0, time.process_time(), sum(link.sent.values()), 0
            time.sleep(max(0.0, began + n * STEP_S - time.monotonic()))
        conductor.send(Cost(link_s, time.process_time() - process_s, sum(link.sent.values()) - sent, received))


async def listen_and_send(port: int, player: Connection) -> Cost:
    """The bridge's side."""
    async with MavsdkVehicle.connect(f"udpin://127.0.0.1:{port}", VEHICLE, time.monotonic_ns) as vehicle:
        player.send("start")
        cpu_s, received, poses, began = time.process_time(), 0, 0, time.monotonic()
        setpoints, calls_s = round(SECONDS * SETPOINTS_HZ), list[float]()
        for n in range(setpoints):
            entered = time.perf_counter()
            vehicle.send_setpoint(SENSORS.specific_force_B, SENSORS.omega_B, SENSORS.omega_B, 0.1)
            calls_s.append(time.perf_counter() - entered)
            if n % round(SETPOINTS_HZ / POSES_HZ) == 0:
                vehicle.send_pose(SENSORS.omega_B, LEVEL, time.monotonic_ns())
                poses += 1
            received += len(vehicle.drain_imu())
            await asyncio.sleep(max(0.0, began + (n + 1) / SETPOINTS_HZ - time.monotonic()))
        player.send("stop")
        spent_s = time.process_time() - cpu_s
        return Cost(spent_s, spent_s, setpoints + poses, received, float(np.median(calls_s)))


def main() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    here, there = get_context("spawn").Pipe()
    player = get_context("spawn").Process(target=play, args=(port, there))
    player.start()
    bridge = asyncio.run(listen_and_send(port, here))
    vehicle: Cost = here.recv()
    player.join()
    print("| side | link, % of a core | whole process | messages/s out | in | link, µs per message |")
    print("|---|---|---|---|---|---|")
    wire = vehicle.sent + bridge.sent
    for name, cost, heard in (("vehicle (pymavlink)", vehicle, bridge.sent), ("bridge (MAVSDK)", bridge, vehicle.sent)):
        share = f"{100 * cost.link_s / SECONDS:.1f} | {100 * cost.process_s / SECONDS:.1f}"
        rates = f"{cost.sent / SECONDS:.0f} | {heard / SECONDS:.0f}"
        print(f"| {name} | {share} | {rates} | {1e6 * cost.link_s / wire:.0f} |")
    print(f"set-points and poses: {bridge.sent} sent, {vehicle.received} received; inertial samples: {bridge.received}")
    print(f"one set-point keeps the loop for {1e6 * bridge.call_s:.0f} µs (median)")


if __name__ == "__main__":
    main()
