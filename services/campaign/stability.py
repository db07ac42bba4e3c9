"""The map of G5: which virtual masses a vehicle that lags can fly on which cables, and why.

The hand is fixed, the cable stands at 56° from the vertical, the filter wants 1.5 N along and 1 N up on the handle. Every
cell of the grid is one vehicle in one batch (simulator/tethered.py). The acceleration set-point is `a_sp = u_R + f̂_c/m_R`,
and u_R holds -f̂_c/M_A, so the estimate enters with f̂_c (1/m_R - 1/M_A): late positive feedback once M_A < m_R. The
set-point's lead fades the horizontal u_R by λ = exp(-b_A lead_s/M_A), as if M_A were M_A/λ: calmer cells.

| symbol | here | unit |
|---|---|---|
| M_A/m_R | Grid.ratio | |
| k_c | Grid.k_c_N_per_m | N/m |
| tension ‖f_c‖ of the last half of the flight | Tension | N |
| Y(jω), from a force on the vehicle along the cable to its velocity along it | Port.Y | m/s/N |
"""

import dataclasses
import math
from collections.abc import Callable, Iterable
from typing import NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from services import cable
from services.cable import Cable
from services.force_estimator.observer import Observer
from services.physics import Array, norm
from services.px4_bridge import admittance
from services.px4_bridge.admittance import Admittance
from services.simulator import tethered
from services.simulator.flight import SUBSTEPS, TICK_S, Latency, Vehicle

Ticks: TypeAlias = Callable[[range], Iterable[int]]
"""What watches the ticks go by, such as a progress bar."""

HAND = np.array([0.0, 0.0, 1.0])
WANTED_N = np.array([1.5, 0.0, 1.0])
ALONG = WANTED_N / np.linalg.norm(WANTED_N)
DELAY_MS = 8.0
"""Each way, with a companion computer beside PX4: what the cascade was fitted with."""

MEASURED_K_C = (50.0, 100.0, 200.0, 400.0)
MEASURED_N = {  # tension std on real PX4 with the cable in its physics and no lead, by vehicle and M_A in kg, for MEASURED_K_C
    "medium": {
        0.8: (0.34, 2.4, 5.3, 6.8),
        1.0: (0.12, 0.67, 3.4, 5.3),
        1.2: (0.06, 0.13, 0.32, 2.1),
        1.35: (0.04, 0.07, 0.15, 0.27),
        1.5: (0.04, 0.05, 0.09, 0.12),
    }
}


class Grid(NamedTuple):
    """The axes of the map; delays count each way and are flown in whole ticks."""

    ratio: Array
    k_c_N_per_m: Array
    observer_Hz: Array
    delay_ms: Array


class Setup(NamedTuple):
    """What does not vary: vehicle, filter (its M_A is replaced), cable (its k_c is replaced) and the set-point's lead."""

    vehicle: Vehicle
    filter: Admittance
    cable: Cable
    lead_s: float


class Tension(NamedTuple):
    """Standard deviation, largest and smallest tension in N, each of the grid's shape (ratio, k_c, observer, delay)."""

    std_N: Array
    max_N: Array
    min_N: Array


class Port(NamedTuple):
    """Admittance at the cable's end, (ratio, observer, delay, frequency)."""

    frequency_Hz: Array
    Y_mps_per_N: NDArray[np.complex128]


class Flown(NamedTuple):
    """One vehicle's map; `name` is what MEASURED_N knows it by."""

    name: str
    mass_kg: float
    lead_s: float
    grid: Grid
    tension: Tension
    port: Port


def fly(grid: Grid, setup: Setup, seconds: float = 20.0, seed: int = 1, watch: Ticks = iter) -> Tension:
    """Fly every cell and look at the tension of the last half of the time."""
    ratio, k_c, observer_Hz, delay_ms = (x.ravel() for x in np.meshgrid(*grid, indexing="ij"))
    p = _robot(ratio, observer_Hz, delay_ms, setup)
    line = dataclasses.replace(setup.cable, k_c_N_per_m=cast(float, k_c))
    start = HAND + cable.offset(np.broadcast_to(WANTED_N, (len(k_c), 3)), line)
    state, command, random = _begin(start, p), _wish(start, p), np.random.default_rng(seed)

    def pull(state: tethered.State) -> Array:
        robot = state.flight.robot
        return -cable.force(robot.p_W, HAND, robot.v_W, np.zeros(3), line)

    ticks = round(seconds / TICK_S)
    tension = np.zeros((ticks - ticks // 2, len(k_c)))
    for i in watch(range(ticks)):
        state = tethered.tick(state, pull(state), command, False, random.standard_normal(start.shape), p)
        for _ in range(SUBSTEPS):
            state = tethered.move(state, pull(state), p)
        if i >= ticks // 2:
            tension[i - ticks // 2] = norm(pull(state))
    shape = tuple(len(axis) for axis in grid)
    return Tension(*(x.reshape(shape) for x in (tension.std(0), tension.max(0), tension.min(0))))


def port(
    grid: Grid,
    setup: Setup,
    frequency_Hz: Array,
    *,
    amplitude_N: float = 0.2,
    seconds: float = 20.0,
    seed: int = 1,
    watch: Ticks = iter,
) -> Port:
    """Measure Y(jω): no cable, a sinusoidal force in its place, and the velocity fitted at the same frequency.

    20 s leave Re Y within 0.5 mm/s/N of what a minute gives; of 8 s the start is still a large part.
    """
    axes = (grid.ratio, grid.observer_Hz, grid.delay_ms, frequency_Hz)
    ratio, observer_Hz, delay_ms, f = (x.ravel() for x in np.meshgrid(*axes, indexing="ij"))
    p = _robot(ratio, observer_Hz, delay_ms, setup)
    start = np.broadcast_to(HAND + ALONG, (len(f), 3))
    state, command, random = _begin(start, p), _wish(start, p), np.random.default_rng(seed)
    ticks, settling = round(seconds / TICK_S), round(0.4 * seconds / TICK_S)
    t, velocity = TICK_S * np.arange(ticks, dtype=np.float64), np.zeros((ticks, len(f)))
    for i in watch(range(ticks)):
        force = -WANTED_N + amplitude_N * np.cos(math.tau * f * t[i])[:, None] * ALONG
        state = tethered.tick(state, force, command, False, random.standard_normal(start.shape), p)
        for _ in range(SUBSTEPS):
            state = tethered.move(state, force, p)
        velocity[i] = state.flight.robot.v_W @ ALONG
    # the force is a staircase, half a tick late on average
    phasors = [_fit(velocity[settling:, k], t[settling:] + TICK_S / 2, tone) for k, tone in enumerate(f)]
    Y = np.array(phasors, dtype=np.complex128) / amplitude_N
    return Port(frequency_Hz, Y.reshape([len(axis) for axis in axes]))


def measured(m: Flown, ratio: int, k_c: int, delay: int) -> float:
    """What real PX4 did in this cell, N; NaN where it was not flown. A virtual mass within 1 % counts as the same."""
    stiffness, M_A_kg = m.grid.k_c_N_per_m[k_c], m.grid.ratio[ratio] * m.mass_kg
    for M_A, row in MEASURED_N.get(m.name, {}).items():
        alike = stiffness in MEASURED_K_C and m.grid.delay_ms[delay] == DELAY_MS and not m.lead_s
        if alike and abs(M_A - M_A_kg) <= 0.01 * M_A:
            return row[MEASURED_K_C.index(stiffness)]
    return math.nan


def whole_ticks(delay_ms: Array) -> Array:
    """The delays that can be flown, nearest to those wanted, ms."""
    return np.unique(np.round(delay_ms / (1e3 * TICK_S))) * (1e3 * TICK_S)


def _robot(ratio: Array, observer_Hz: Array, delay_ms: Array, setup: Setup) -> tethered.Robot:
    """A batch: scalars of the laws are arrays (cells,) of it."""
    mass, late = setup.vehicle.quadrotor.mass_kg, np.round(delay_ms / (1e3 * TICK_S)).astype(np.int64)
    return tethered.Robot(
        setup.vehicle,
        dataclasses.replace(setup.filter, M_A_kg=cast(float, ratio * mass)),
        Observer(m_R_kg=mass, bandwidth_Hz=cast(float, observer_Hz)),
        Latency(late, late),
        lead_s=setup.lead_s,
    )


def _begin(p_R: Array, p: tethered.Robot) -> tethered.State:
    return tethered.hovering(p_R, WANTED_N, p)


def _wish(p_R: Array, p: tethered.Robot) -> admittance.Command:
    """Where it is, and WANTED_N on the hand."""
    return admittance.guide(p_R, np.broadcast_to(WANTED_N, p_R.shape), 1.0, p.filter)


def _fit(signal: Array, t: Array, frequency_Hz: float) -> complex:
    """Phasor of `signal` relative to a cosine, beside a drift."""
    angle = math.tau * frequency_Hz * t
    basis = np.stack((np.cos(angle), np.sin(angle), np.ones_like(t), t), axis=-1)
    cosine, sine = np.linalg.lstsq(basis, signal)[0][:2]
    return complex(cosine, -sine)
