"""The map of G5 on the PX4-like vehicle: where real PX4 was calm, and where it was not."""

import dataclasses

import numpy as np
import pytest

from services.campaign import stability
from services.campaign.stability import MEASURED_K_C, MEASURED_N, Flown, Grid, Port, Setup
from services.campaign.stability_map import CALM_N, NOT_PASSIVE_MPS_PER_N, verdict
from services.config import load, load_vehicle

pytestmark = pytest.mark.slow

SECONDS = 12.0  # long enough for the start to be forgotten, or for a limit cycle to grow
LIMIT_CYCLE_N = 1.0
RATIOS = {"medium": (0.8, 1.0, 1.2, 1.35, 1.5, 2.0), "light": (0.5, 0.72, 0.8, 1.0)}
NO_PORT = Port(np.zeros(0), np.zeros(0, dtype=np.complex128))


LEAD_S = load("demo").px4_bridge.flight.lead_s


def setup_of(vehicle: str, d_c: float = 1.0, lead_s: float = 0.0) -> Setup:
    """Without the lead, as real PX4 was flown."""
    profile = load("demo")
    line = dataclasses.replace(profile.cable, d_c_Ns_per_m=d_c)
    return Setup(load_vehicle(vehicle), profile.px4_bridge.admittance, line, lead_s)


def grid_of(vehicle: str, k_c: tuple[float, ...], observer: tuple[float, ...] = (8.0,)) -> Grid:
    mass = load_vehicle(vehicle).quadrotor.mass_kg
    return Grid(np.array(RATIOS[vehicle]) / mass, np.array(k_c), np.array(observer), np.array([8.0]))


def flown(vehicle: str, grid: Grid, seconds: float, lead_s: float = 0.0) -> Flown:
    setup = setup_of(vehicle, lead_s=lead_s)
    mass = setup.vehicle.quadrotor.mass_kg
    return Flown(vehicle, mass, lead_s, grid, stability.fly(grid, setup, seconds), NO_PORT)


@pytest.fixture(scope="module")
def medium() -> Flown:
    return flown("medium", grid_of("medium", MEASURED_K_C), SECONDS)


@pytest.fixture(scope="module")
def light() -> Flown:
    return flown("light", grid_of("light", (100.0, 200.0, 500.0)), 8.0)


def test_every_cell_that_flight_allows_is_calm(medium: Flown, light: Flown) -> None:
    for m in (medium, light):
        allowed = m.grid.ratio >= 0.9 - 1e-9
        assert allowed.any()
        assert m.tension.std_N[allowed].max() < CALM_N
        assert m.tension.min_N[allowed].min() > 0.0


def test_the_lead_that_flies_leaves_every_allowed_cell_calm_and_most_others_calmer(medium: Flown) -> None:
    led = flown("medium", medium.grid, SECONDS, LEAD_S)
    allowed = led.grid.ratio >= 0.9 - 1e-9
    assert led.tension.std_N[allowed].max() < CALM_N
    assert led.tension.min_N[allowed].min() > 0.0
    assert np.all(led.tension.std_N < medium.tension.std_N + 0.02)
    assert np.isnan(stability.measured(led, 0, 0, 0))  # real PX4's map was flown without it


def test_the_papers_virtual_mass_limit_cycles_on_the_heavy_vehicle(medium: Flown) -> None:
    papers, stiff = np.isclose(medium.grid.ratio, 0.8 / 1.5), medium.grid.k_c_N_per_m >= 100.0
    assert medium.tension.std_N[papers][:, stiff].min() > LIMIT_CYCLE_N
    assert medium.tension.min_N[papers][:, stiff].max() == 0.0


def test_the_papers_virtual_mass_is_calm_on_the_light_vehicle_up_to_500(light: Flown) -> None:
    std = light.tension.std_N
    assert std[np.isclose(light.grid.ratio, 1.0)].max() < CALM_N
    assert std[np.isclose(light.grid.ratio, 0.5 / 0.8)][:, light.grid.k_c_N_per_m >= 200.0].min() > LIMIT_CYCLE_N


def test_cell_by_cell_it_is_calm_or_not_where_real_px4_was(medium: Flown) -> None:
    compared = 0
    for i, j, _, d in np.ndindex(medium.tension.std_N.shape):
        real, simulated = stability.measured(medium, i, j, d), medium.tension.std_N[i, j, 0, d]
        compared += bool(np.isfinite(real))
        if real > 2 * LIMIT_CYCLE_N:
            assert simulated == pytest.approx(real, rel=0.4), (i, j)
        elif real < CALM_N / 2:
            assert simulated < CALM_N, (i, j)
    assert compared == sum(map(len, MEASURED_N["medium"].values()))


def test_the_observers_bandwidth_does_not_rescue_a_light_virtual_mass() -> None:
    grid = Grid(np.array([0.53, 1.0]), np.array([200.0]), np.array([2.0, 8.0, 20.0]), np.array([8.0]))
    std = flown("medium", grid, 8.0).tension.std_N[:, 0, :, 0]
    assert std[0].min() > LIMIT_CYCLE_N
    assert std[1].max() < CALM_N


def test_a_cell_of_the_batch_is_the_cell_flown_alone() -> None:
    grid = Grid(np.array([0.53, 1.0]), np.array([100.0, 200.0]), np.array([4.0, 8.0]), np.array([0.0, 8.0]))
    setup = setup_of("light")
    silent = setup._replace(
        vehicle=dataclasses.replace(
            setup.vehicle, imu=dataclasses.replace(setup.vehicle.imu, accel_density_mps2_per_rtHz=0.0)
        )
    )
    many = stability.fly(grid, silent, 2.0)
    for i, j, o, d in ((0, 1, 0, 1), (1, 0, 1, 0)):
        one = stability.fly(Grid(*(a[[k]] for a, k in zip(grid, (i, j, o, d), strict=True))), silent, 2.0)
        assert many.std_N[i, j, o, d] == pytest.approx(one.std_N.item(), rel=1e-6, abs=1e-9)


def test_the_cable_port_is_passive_from_the_vehicles_mass_on_and_not_below() -> None:
    ratios = np.array([0.8, 1.2, 1.35, 1.5, 2.0]) / 1.5
    grid = Grid(ratios, np.array([]), np.array([8.0]), np.array([8.0]))
    port = stability.port(grid, setup_of("medium"), np.array([0.7, 1.2, 1.7, 2.4, 3.4]))
    led = stability.port(grid, setup_of("medium", lead_s=LEAD_S), np.array([1.7, 2.4, 3.4]))
    worst = port.Y_mps_per_N.real.min(axis=-1)[:, 0, 0]
    assert np.all(worst[ratios < 0.99] < -5e-4)  # at 0.9, which flight allows, the cable's own damping makes up for it
    assert np.all(worst[ratios > 0.99] > NOT_PASSIVE_MPS_PER_N)
    assert np.all(led.Y_mps_per_N.real.min(axis=-1)[ratios > 0.99] > NOT_PASSIVE_MPS_PER_N)  # and so with the lead


def test_without_damping_in_the_cable_nine_tenths_of_the_mass_is_not_enough() -> None:
    """Flight allows a ratio of 0.9, whose port is a little active; in the map the cable's 1 N s/m makes up for that."""
    grid = Grid(np.array([0.9, 1.0, 1.33]), np.array([400.0]), np.array([8.0]), np.array([8.0]))
    bare = stability.fly(grid, setup_of("medium", d_c=0.0), SECONDS)
    assert bare.std_N[0] > LIMIT_CYCLE_N
    assert bare.min_N[0] == 0.0
    assert bare.std_N[2] < CALM_N  # and at 1.0 the start rings for a minute, but it decays


def test_a_cell_that_is_not_a_number_is_not_calm() -> None:
    assert verdict(0.01, 1.5) == "calm"
    assert verdict(0.5, 1.0) == verdict(float("nan"), float("nan")) == "sways"
    assert verdict(0.01, 0.0) == "slack"
