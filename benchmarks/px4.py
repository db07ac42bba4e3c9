"""`make bench-px4`: the experiment, a push, the map of G5 and a dead bridge on real PX4 in software; needs PX4_BIN.

The flights are unthrottled: services on virtual time, PX4 in lockstep. `--real-time N` adds N flights of the demo as its
own processes, which say what the clock and MAVSDK make of it.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks import flight_demo, px4_age
from benchmarks.px4_rig import Rig, px4
from benchmarks.table import show
from schemas.safety import Phase
from schemas.topics import TRUTH
from services import cable
from services.cable import Cable
from services.campaign import stability
from services.config import Config, load
from services.physics import Array, norm
from services.px4_bridge import admittance
from services.recorder import reading, summary
from services.rehearsal import px4_flight
from services.rehearsal.quick import quicker
from services.simulator import tethered
from services.simulator.autopilot import STEP_S
from services.simulator.flight import SUBSTEPS
from services.simulator.quadrotor import QuadrotorState
from services.simulator.tethered import Robot
from tests.services import px4_chain, px4_fall

COLUMNS = (*flight_demo.COLUMNS, "times real time")
PUSH_COLUMNS = ("vehicle", "push N", "peak cm", "after 3 s cm", "simulated: peak cm")
MAP_COLUMNS = ("vehicle", "M_A kg", "k_c N/m", "PX4: tension std N", "simulated", "verdicts")
CELLS = (  # at least two on each side of the border, on both vehicles
    ("medium", 0.8, 50.0),
    ("medium", 0.8, 200.0),
    ("medium", 1.2, 400.0),
    ("medium", 1.5, 200.0),
    ("medium", 1.5, 400.0),
    ("medium", 2.0, 200.0),
    ("light", 0.5, 400.0),
    ("light", 0.8, 400.0),
)
FALL_COLUMNS = ("killed in", "offboard left s", "on the ground s", "disarmed s", "pull after 1.5 s N")
CALM_N = 0.35
PUSH_N, PUSH_S = 1.5, 3.0
SIDE_N = np.array([0.0, PUSH_N, 0.0])


def flights(seeds: Sequence[int]) -> list[tuple[str, ...]]:
    """The whole experiment, each with noise of its own."""
    return [_flight(seed) for seed in seeds]


def _flight(seed: int) -> tuple[str, ...]:
    with tempfile.TemporaryDirectory() as folder:
        began = time.monotonic()
        px4_flight.fly(px4_chain.px4_config(Path(folder), seed), px4_flight.whole)
        wall_s = time.monotonic() - began
        session = reading.read(Path(folder) / "session.mcap")
        result: dict[str, Any] = json.loads(summary.summarise(session).to_json())
        row = (*flight_demo.row(seed, result), f"{session.duration_s / wall_s:.1f}")
        print(*row, flush=True, file=sys.stderr)
        return row


class Push(NamedTuple):
    """Distance of the vehicle from the filter's reference in m: largest, and at the end of the push."""

    peak_m: float
    end_m: float


def push(vehicle: str) -> Push:
    """A sudden side pull on a vehicle that hovers with the filter engaged, as a hand on the cable would."""
    with rig_of(vehicle) as rig:
        hover = np.array([0.0, 0.0, 1.5])
        rig.take_off(hover)
        command = admittance.ease(hover, rig.filter)
        away = list[float]()
        for _ in range(round(PUSH_S / STEP_S)):
            rig.tick(command, lambda _state: SIDE_N)
            away.append(float(norm(rig.state.p_W - rig.reference.p)))
        return Push(max(away), away[-1])


def simulated_push(vehicle: str) -> Push:
    """The same on the stand-in's control."""
    config, hover = config_of(vehicle), np.array([0.0, 0.0, 1.5])
    lead_s = config.px4_bridge.flight.lead_s
    robot = Robot(config.vehicle, config.px4_bridge.admittance, config.force_estimator.observer, lead_s=lead_s)
    state, command, away = (
        tethered.hovering(hover, np.zeros(3), robot),
        admittance.ease(hover, robot.filter),
        list[float](),
    )
    for _ in range(round(PUSH_S / STEP_S)):
        state = tethered.tick(state, SIDE_N, command, False, np.zeros(3), robot)
        for _ in range(SUBSTEPS):
            state = tethered.move(state, SIDE_N, robot)
        away.append(float(norm(state.flight.robot.p_W - state.reference.p)))
    return Push(max(away), away[-1])


def cell(vehicle: str, M_A_kg: float, k_c: float, seconds: float = 16.0) -> Array:
    """Tension in N of the last half, one per 4 ms: the hand fixed, the cable at 56°, as in the simulated map."""
    with rig_of(vehicle, M_A_kg, pace=3.0) as rig:
        wanted, hand = stability.WANTED_N, stability.HAND
        line = Cable(rest_length_m=1.0, k_c_N_per_m=k_c, d_c_Ns_per_m=1.0)
        start = hand + cable.offset(wanted, line)
        rig.take_off(start)
        soft = replace(rig.filter, k_H_N_per_m=1e-6)
        command = admittance.guide(start, wanted, 1.0, soft)

        def pull(state: QuadrotorState) -> Array:
            return -cable.force(state.p_W, hand, state.v_W, np.zeros(3), line)

        tension = list[float]()  # it begins with a jerk, from the hover into the taut cable, as the simulated map does
        for _ in range(round(seconds / STEP_S)):
            rig.tick(command, pull)
            tension.append(float(norm(pull(rig.state))))
        return np.array(tension[len(tension) // 2 :])


@contextmanager
def rig_of(vehicle: str, M_A_kg: float = 0.0, pace: float = 1.0) -> Generator[Rig]:
    """A rig with a PX4 of its own; the virtual mass is the vehicle's where none is given."""
    config = config_of(vehicle)
    with tempfile.TemporaryDirectory() as folder, px4(config, Path(folder)) as hil:
        rig = Rig(config, hil, M_A_kg or config.vehicle.quadrotor.mass_kg, pace)
        with closing(rig.vehicle):
            yield rig


def config_of(vehicle: str) -> Config:
    """The profile with another vehicle."""
    with tempfile.NamedTemporaryFile("w", suffix=".toml") as file:
        file.write(f'base = "px4-sitl"\n[system]\nvehicle = "{vehicle}"\n')
        file.flush()
        return load(file.name, px4=px4_chain.PX4_BIN)


def pushes() -> list[tuple[str, ...]]:
    rows = list[tuple[str, ...]]()
    for vehicle in ("light", "medium"):
        real, simulated = push(vehicle), simulated_push(vehicle)
        numbers = (real.peak_m, real.end_m, simulated.peak_m)
        rows.append((vehicle, f"{PUSH_N:g}", *(f"{100 * x:.1f}" for x in numbers)))
    return rows


def simulated_std_N(config: Config, M_A_kg: float, k_c: float) -> float:
    """The same cell with the stand-in's cascade."""
    setup = stability.Setup(config.vehicle, config.px4_bridge.admittance, config.cable, config.px4_bridge.flight.lead_s)
    axes = (M_A_kg / config.vehicle.quadrotor.mass_kg, k_c, config.force_estimator.observer.bandwidth_Hz)
    grid = stability.Grid(*(np.array([x]) for x in (*axes, stability.DELAY_MS)))
    return float(stability.fly(grid, setup, seconds=16.0).std_N.item())


def the_map() -> list[tuple[str, ...]]:
    rows = list[tuple[str, ...]]()
    for vehicle, M_A_kg, k_c in CELLS:
        real = float(cell(vehicle, M_A_kg, k_c).std())
        simulated = simulated_std_N(config_of(vehicle), M_A_kg, k_c)
        same = "same" if (real < CALM_N) == (simulated < CALM_N) else "NOT THE SAME"
        verdict = "calm" if real < CALM_N else "limit cycle"
        rows.append((vehicle, f"{M_A_kg:g}", f"{k_c:g}", f"{real:.2f}", f"{simulated:.2f}", f"{same}: {verdict}"))
        print(*rows[-1], flush=True, file=sys.stderr)
    return rows


def real_time(n: int) -> list[tuple[str, ...]]:
    """The demo as its own processes; the factor is the world's time over the host's."""
    rows = list[tuple[str, ...]]()
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(1, n + 1):
            result = flight_demo.fly(Path(folder), seed, "px4-sitl")
            stamps = reading.read(result["folder"] / "session.mcap").table(TRUTH)["t_s"]
            factor = (len(stamps) - 1) / TRUTH.rate_Hz / float(stamps[-1] - stamps[0])
            rows.append((*flight_demo.row(seed, result), f"{factor:.3f}"))
    return rows


def falls() -> list[tuple[str, ...]]:
    """The bridge is killed; PX4 has neither set-points nor poses from then on."""
    rows = list[tuple[str, ...]]()
    for phase in (Phase.ZEROING, Phase.READY, Phase.GUIDING, Phase.ARRIVED):
        with tempfile.TemporaryDirectory() as folder:
            fall = px4_fall.without_bridge(quicker(px4_chain.px4_config(Path(folder))), phase)
        rows.append((phase.value, *(f"{seconds:.1f}" for seconds in fall[:3]), f"{fall.pull_N:.2f}"))
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--real-time", type=int, default=1)
    parser.add_argument("--only", choices=("flights", "push", "map", "killed", "age", "real-time"))
    told = parser.parse_args()
    if not px4_chain.PX4_BIN:
        print("bench-px4: skipped: PX4_BIN is not set")
        return 0
    seeds = range(told.first_seed, told.first_seed + told.seeds)
    parts: dict[str, tuple[str, Callable[[], object]]] = {
        "flights": (
            "The experiment on PX4",
            lambda: show(flights(seeds), COLUMNS),
        ),
        "push": ("A side pull in hover, from the reference", lambda: show(pushes(), PUSH_COLUMNS)),
        "map": ("The map of G5", lambda: show(the_map(), MAP_COLUMNS)),
        "killed": ("The bridge is killed", lambda: show(falls(), FALL_COLUMNS)),
        "age": ("How old a set-point is when PX4 shows it", lambda: show(px4_age.run(), px4_age.COLUMNS)),
        "real-time": ("In real time", lambda: show(real_time(told.real_time), COLUMNS)),
    }
    for name, (title, measure) in parts.items():
        if told.only in (None, name):
            print(f"\n## {title}\nload {os.getloadavg()[0]:.1f}\n", flush=True)
            measure()
    return 0


if __name__ == "__main__":
    sys.exit(main())
