"""The map of G5 on the stand-in autopilot: where real PX4 was calm, and where it was not."""

import numpy as np
import pytest

from benchmarks import stability_map
from benchmarks.stability_map import MEASURED, STIFFNESS
from services.config import load_vehicle

SECONDS = 12.0  # long enough for the start to be forgotten, or for a limit cycle to grow
CALM_N, LIMIT_CYCLE_N = 0.35, 1.0


@pytest.fixture(scope="module")
def medium():
    return stability_map.run("medium", seconds=SECONDS)


@pytest.fixture(scope="module")
def light():
    return stability_map.run("light", seconds=8.0, k_c_N_per_m=(100.0, 200.0, 500.0))


def test_every_cell_that_flight_allows_is_calm(medium, light):
    for result in (medium, light):
        allowed = result.M_A_kg >= 0.9 * load_vehicle(result.vehicle).quadrotor.mass_kg - 1e-9
        assert allowed.any()
        assert result.std_N[allowed].max() < CALM_N
        assert result.min_N[allowed].min() > 0.0


def test_the_papers_virtual_mass_limit_cycles_on_the_heavy_vehicle(medium):
    papers = medium.M_A_kg == 0.8
    stiff = medium.k_c_N_per_m >= 100.0
    assert medium.std_N[papers][:, stiff].min() > LIMIT_CYCLE_N
    assert medium.min_N[papers][:, stiff].max() == 0.0


def test_the_papers_virtual_mass_is_calm_on_the_light_vehicle_up_to_500(light):
    assert light.std_N[light.M_A_kg == 0.8].max() < CALM_N
    assert light.std_N[light.M_A_kg == 0.5][:, light.k_c_N_per_m >= 200.0].min() > LIMIT_CYCLE_N


def test_cell_by_cell_it_is_calm_or_not_where_real_px4_was(medium):
    for i, M_A in enumerate(medium.M_A_kg):
        for j, real in enumerate(MEASURED.get(("medium", float(M_A)), ())):
            simulated = medium.std_N[i, j]
            if real > 2 * LIMIT_CYCLE_N:
                assert simulated == pytest.approx(real, rel=0.4), (M_A, STIFFNESS[j])
            elif real < CALM_N / 2:
                assert simulated < CALM_N, (M_A, STIFFNESS[j])


def test_the_cable_port_is_passive_from_the_vehicles_mass_on_and_not_below():
    port = stability_map.port(
        "medium", M_A_kg=(0.8, 1.2, 1.5, 2.0), frequency_Hz=(0.7, 1.2, 1.7, 2.4, 3.4), seconds=SECONDS
    )
    worst = port.Y_mps_per_N.real.min(axis=1)
    assert np.all(worst[port.M_A_kg < 1.5] < -1e-3)
    assert np.all(worst[port.M_A_kg >= 1.5] > -1e-4)
