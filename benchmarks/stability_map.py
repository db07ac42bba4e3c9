"""The map of G5: which virtual masses a vehicle with a delay can fly on which cables.

The hand is fixed, the cable stands at 56° from the vertical, the filter wants 1.5 N along and 1 N up on the handle. Every
cell of the grid (virtual mass M_A by cable stiffness k_c) is one vehicle in one batch; it is calm where the tension of the
last seconds hardly varies. The acceleration set-point is `a_sp = u_R + f̂_c/m_R`: u_R holds -f̂_c/M_A, and the vehicle feels
-f_c, so the estimate enters with f̂_c (1/m_R - 1/M_A): positive feedback, late, once M_A < m_R.

`python -m benchmarks.stability_map --out DIR` writes stability_map.png.
"""

import argparse
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from services import cable
from services.cable import Cable
from services.config import load_vehicle
from services.force_estimator.observer import Observer
from services.physics import norm
from services.px4_bridge import admittance
from services.px4_bridge.admittance import Admittance
from services.simulator import tethered
from services.simulator.flight import SUBSTEPS, TICK_S, Latency, Vehicle
from services.simulator.quadrotor import QuadrotorState
from services.simulator.tethered import Robot

Array = NDArray[np.float64]

HAND = np.array([0.0, 0.0, 1.0])
WANTED_N = np.array([1.5, 0.0, 1.0])
ALONG = WANTED_N / np.linalg.norm(WANTED_N)
STIFFNESS = (50.0, 100.0, 200.0, 400.0)
MASSES = {"medium": (0.8, 1.0, 1.2, 1.35, 1.5, 2.0), "light": (0.5, 0.72, 0.8, 1.0)}

FILTER = {  # the paper's b_A and k_H; the rest is not used here, where the cable is taut and the handle held
    "b_A_Ns_per_m": 2.4,
    "k_H_N_per_m": 4.5,
    "k_z_N_per_m": 4.5,
    "e_R_max_m": 0.22,
    "b_free_Ns_per_m": 10.0,
    "b_slack_Ns_per_m": 10.0,
    "slack_keep_s": 1.0,
}

# Tension std in N on real PX4 with the cable in its physics (G5), for the stiffnesses above.
MEASURED: dict[tuple[str, float], tuple[float, ...]] = {
    ("medium", 0.8): (0.34, 2.4, 5.3, 6.8),
    ("medium", 1.0): (0.12, 0.67, 3.4, 5.3),
    ("medium", 1.2): (0.06, 0.13, 0.32, 2.1),
    ("medium", 1.35): (0.04, 0.07, 0.15, 0.27),
    ("medium", 1.5): (0.04, 0.05, 0.09, 0.12),
}


class Result(NamedTuple):
    """One vehicle's map: std, largest and smallest tension in N of the last seconds, (M_A, k_c)."""

    vehicle: str
    M_A_kg: Array
    k_c_N_per_m: Array
    std_N: Array
    max_N: Array
    min_N: Array


class Loop:
    """A batch of robots under a wish for WANTED_N, and their sensors' noise; `tick` advances 4 ms."""

    def __init__(self, vehicle: Vehicle, M_A_kg: Array, p_R: Array, bandwidth_Hz: float, latency: Latency) -> None:
        # Laws broadcast over parameters as well: a scalar of the law may be an array (...) of the batch.
        self.p = Robot(
            vehicle,
            Admittance(M_A_kg=cast(float, M_A_kg), **FILTER),
            Observer(m_R_kg=vehicle.quadrotor.mass_kg, bandwidth_Hz=bandwidth_Hz),
            latency,
        )
        self.state = tethered.hovering(p_R, WANTED_N, self.p)
        self.command = admittance.guide(p_R, np.broadcast_to(WANTED_N, p_R.shape), 1.0, self.p.filter)
        self.random = np.random.default_rng(1)

    @property
    def robot(self) -> QuadrotorState:
        return self.state.flight.robot

    def tick(self, force: Callable[[QuadrotorState], Array]) -> None:
        """One round of control, then the physics under `force` on the vehicle in N."""
        normal = self.random.standard_normal(self.robot.p_W.shape)
        self.state = tethered.tick(self.state, force(self.robot), self.command, False, normal, self.p)
        for _ in range(SUBSTEPS):
            self.state = tethered.move(self.state, force(self.robot), self.p)


def run(
    vehicle: str = "medium",
    *,
    M_A_kg: Sequence[float] | None = None,
    k_c_N_per_m: Sequence[float] = STIFFNESS,
    seconds: float = 20.0,
    bandwidth_Hz: float = 10.0,
    latency: Latency | None = None,
) -> Result:
    """Fly the grid and look at the tension of the last half of the time."""
    masses = np.array(M_A_kg or MASSES[vehicle])
    M_A, k_c = (x.ravel() for x in np.meshgrid(masses, k_c_N_per_m, indexing="ij"))
    line = Cable(rest_length_m=1.0, k_c_N_per_m=cast(float, k_c), d_c_Ns_per_m=1.0)
    start = HAND + ALONG * (1.0 + np.linalg.norm(WANTED_N) / k_c[:, None])
    loop = Loop(load_vehicle(vehicle), M_A, start, bandwidth_Hz, latency or Latency())

    def pull(state: QuadrotorState) -> Array:
        return -cable.force(state.p_W, HAND, state.v_W, np.zeros(3), line)

    tension = np.zeros((round(seconds / TICK_S), len(M_A)))
    for row in tension:
        loop.tick(pull)
        row[:] = norm(pull(loop.robot))
    last = tension[len(tension) // 2 :]
    grid = (len(masses), len(k_c_N_per_m))
    std, high, low = (x.reshape(grid) for x in (last.std(0), last.max(0), last.min(0)))
    return Result(vehicle, masses, np.array(k_c_N_per_m), std, high, low)


class Port(NamedTuple):
    """Admittance at the cable's end, from a force on the vehicle along the cable to its velocity: (M_A, frequency)."""

    vehicle: str
    M_A_kg: Array
    frequency_Hz: Array
    Y_mps_per_N: NDArray[np.complex128]


def port(
    vehicle: str = "medium",
    *,
    M_A_kg: Sequence[float] | None = None,
    frequency_Hz: Sequence[float] = tuple(np.geomspace(0.5, 8.0, 17)),
    amplitude_N: float = 0.2,
    seconds: float = 20.0,
) -> Port:
    """Measure Y(jω): no cable, a sinusoidal force in its place, and the velocity fitted at the same frequency."""
    masses, tones = np.array(M_A_kg or MASSES[vehicle]), np.array(frequency_Hz)
    M_A, f = (x.ravel() for x in np.meshgrid(masses, tones, indexing="ij"))
    loop = Loop(load_vehicle(vehicle), M_A, np.broadcast_to(HAND + ALONG, (len(f), 3)), 10.0, Latency())
    ticks, settling = round(seconds / TICK_S), round(0.4 * seconds / TICK_S)
    velocity = np.zeros((ticks, len(f)))
    t = TICK_S * np.arange(ticks, dtype=np.float64)
    for i in range(ticks):
        push = amplitude_N * np.cos(math.tau * f * t[i])
        force = -WANTED_N + push[:, None] * ALONG
        loop.tick(lambda _, force=force: force)
        velocity[i] = loop.robot.v_W @ ALONG
    Y = [_fit(velocity[settling:, k], t[settling:] + TICK_S / 2, tone) / amplitude_N for k, tone in enumerate(f)]
    return Port(vehicle, masses, tones, np.array(Y).reshape(len(masses), len(tones)))


def _fit(signal: Array, t: Array, frequency_Hz: float) -> complex:
    """Phasor of `signal` relative to a cosine, beside a drift."""
    angle = math.tau * frequency_Hz * t
    basis = np.stack((np.cos(angle), np.sin(angle), np.ones_like(t), t), axis=-1)
    cosine, sine = np.linalg.lstsq(basis, signal)[0][:2]
    return complex(cosine, -sine)


def table(result: Result) -> str:
    """The map as text: simulated, and in brackets measured, tension std in N."""
    head = f"{result.vehicle}: tension std in N; k_c = " + ", ".join(f"{k:g}" for k in result.k_c_N_per_m)
    rows = [head]
    for M_A, row in zip(result.M_A_kg, result.std_N, strict=True):
        known = MEASURED.get((result.vehicle, float(M_A)), ()) if tuple(result.k_c_N_per_m) == STIFFNESS else ()
        cells = [f"{s:5.2f} ({known[i]:g})" if i < len(known) else f"{s:5.2f}" for i, s in enumerate(row)]
        rows.append(f"  M_A = {M_A:4.2f} kg  " + "  ".join(cells))
    return "\n".join(rows)


def draw(maps: Sequence[Result], ports: Sequence[Port], path: Path) -> None:
    """Left to right for each vehicle: the map with measured values in brackets, and Re Y(jω)."""
    figure: Any = Figure(figsize=(12, 4.2 * len(maps)), layout="constrained")
    axes = figure.subplots(len(maps), 2, squeeze=False)
    for (cells, curves), result, Y in zip(axes, maps, ports, strict=True):
        _draw_map(cells, result)
        for M_A, row in zip(Y.M_A_kg, Y.Y_mps_per_N, strict=True):
            curves.semilogx(Y.frequency_Hz, row.real, label=f"M_A = {M_A:g} kg")
        curves.axhline(0.0, color="black", linewidth=0.8)
        curves.set(title="admittance at the cable port", xlabel="frequency in Hz", ylabel="Re Y in m/s/N")
        curves.set(ylim=(-0.03, 0.12), xticks=(ticks := (0.5, 1, 2, 4, 8)), xticklabels=[f"{f:g}" for f in ticks])
        curves.minorticks_off()
        curves.legend(fontsize="small")
    figure.savefig(path, dpi=120)


def _draw_map(axes: Any, result: Result) -> None:
    axes.imshow(
        np.log10(np.maximum(result.std_N, 1e-2)), cmap="RdYlGn_r", vmin=-1.7, vmax=0.7, aspect="auto", alpha=0.6
    )
    mass = load_vehicle(result.vehicle).quadrotor.mass_kg
    axes.set(title=f"{mass:g} kg: tension std in N (real PX4)", xlabel="k_c in N/m", ylabel="M_A in kg")
    axes.set_xticks(range(len(result.k_c_N_per_m)), [f"{k:g}" for k in result.k_c_N_per_m])
    axes.set_yticks(range(len(result.M_A_kg)), [f"{m:g}" for m in result.M_A_kg])
    for i, M_A in enumerate(result.M_A_kg):
        known = MEASURED.get((result.vehicle, float(M_A)), ())
        for j, std in enumerate(result.std_N[i]):
            axes.text(j, i, f"{std:.2f}" + (f" ({known[j]:g})" if j < len(known) else ""), ha="center", va="center")


def main() -> None:
    parser = argparse.ArgumentParser(description="The stability map of G5.")
    parser.add_argument("--out", type=Path, required=True, help="directory of stability_map.png")
    out: Path = parser.parse_args().out
    maps = [run("medium"), run("light")]
    for result in maps:
        print(table(result))
    out.mkdir(parents=True, exist_ok=True)
    draw(maps, [port("medium"), port("light")], out / "stability_map.png")


if __name__ == "__main__":
    main()
