"""The paper's statistics, on walks whose error is known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.physics import Array
from services.recorder import metrics
from tests.laws import ideal

PATH = ideal.paper_path_cached()
S = np.linspace(0.05, 0.95, 19)


def beside(offset: Array, s: Array) -> Array:
    return PATH.p(s) + offset[:, None] * PATH.normal(s)


@given(st.floats(-0.3, 0.3), st.integers(100, 800))
def test_a_parallel_walk_has_its_offset_everywhere(offset: float, samples: int) -> None:
    along = np.linspace(0.0, 1.0, samples)
    error = metrics.path_error(beside(np.full(samples, offset), along), PATH, S)
    assert error == pytest.approx([offset] * len(S), abs=3e-4)


def test_the_error_follows_a_wave_and_its_sign_is_left() -> None:
    along = np.linspace(0.0, 1.0, 1500)
    wave = 0.05 * np.sin(7 * along)
    error = metrics.path_error(beside(wave, along), PATH, S)
    assert error == pytest.approx(0.05 * np.sin(7 * S), abs=5e-4)


def test_speed_stops_and_ways_back_do_not_count_but_the_nearest_crossing_does() -> None:
    there = np.linspace(0.0, 0.7, 300)
    back = np.linspace(0.7, 0.3, 200)
    again = np.linspace(0.3, 1.0, 500)
    walk = np.vstack(
        (
            beside(np.full(300, -0.10), there),
            np.tile(beside(np.array([-0.10]), np.array([0.7])), (50, 1)),
            beside(np.full(200, 0.03), back),
            beside(np.full(500, 0.06), again),
        )
    )
    error = metrics.path_error(walk, PATH, np.array([0.2, 0.5, 0.9]))
    assert error == pytest.approx([-0.10, 0.03, 0.06], abs=5e-4)


def test_a_walk_that_ends_early_has_no_error_beyond() -> None:
    along = np.linspace(0.0, 0.5, 300)
    error = metrics.path_error(beside(np.zeros(300), along), PATH, np.array([0.2, 0.6]))
    assert error[0] == pytest.approx(0.0, abs=1e-4)
    assert np.isnan(error[1])


def test_a_walk_that_only_touches_the_normal_counts() -> None:
    ends_on_it = beside(np.full(3, 0.02), np.array([0.3, 0.4, 0.5]))
    assert metrics.path_error(ends_on_it, PATH, np.array([0.4]))[0] == pytest.approx(0.02, abs=1e-9)


def test_statistics_over_runs_skip_what_is_undefined() -> None:
    runs = np.array([[0.1, np.nan, np.nan], [0.3, 0.2, np.nan]])
    assert metrics.mean_over_runs(runs) == pytest.approx([0.2, 0.2, np.nan], nan_ok=True)
    assert metrics.std_over_runs(runs) == pytest.approx([np.sqrt(0.02), np.nan, np.nan], nan_ok=True)
    assert metrics.tube_diameter(runs) == pytest.approx(0.6)


@given(st.floats(-0.3, 0.3), st.floats(0.05, 0.95))
def test_distance_is_to_the_nearest_point(offset: float, s: float) -> None:
    walk = beside(np.array([offset]), np.array([s]))
    assert metrics.distance(walk, PATH)[0] == pytest.approx(abs(offset), abs=1e-6)
    assert metrics.reference_error(walk, PATH.p(np.array([s])))[0] == pytest.approx(abs(offset))


def test_arrival_is_the_time_from_which_the_hand_stays() -> None:
    t = np.arange(6.0)
    end = PATH.p(1.0)
    walk = end + np.outer([1.0, 0.05, 0.5, 0.09, 0.02, 0.0], [1.0, 0.0, 0.0])
    assert metrics.arrival_time(t, walk, PATH, 0.1) == 3.0
    assert np.isnan(metrics.arrival_time(t, walk[::-1], PATH, 0.1))


def test_slack_fraction_and_rms() -> None:
    l_c = np.array([[0.0, 0.0, 1.01], [0.0, 0.0, 0.9], [0.0, 0.0, 1.1], [0.0, 0.0, 1.2]])
    assert metrics.slack_fraction(l_c, 1.0) == 0.25
    assert metrics.rms(np.array([3.0, 4.0])) == pytest.approx(np.sqrt(12.5))
    assert metrics.rms(np.array([[3.0, 4.0, 0.0]])) == pytest.approx(5.0)
