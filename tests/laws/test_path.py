"""The path: smooth, by arc length; the projection: the nearest point, on the branch where the person is."""

import math
from functools import cache
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq, minimize_scalar

from services.guiding_controller import guiding
from services.guiding_controller.path import Path, Trapezoid, project, through
from services.guiding_controller.path_file import check, read
from services.guiding_controller.spline import Cubic, not_a_knot
from services.physics import Array, norm
from tests.laws import ideal
from tests.laws.strategies import vectors

FORCE = Trapezoid(f_start_N=0.75, f_max_N=1.5, ramp_up_fraction=0.1, ramp_down_fraction=0.15)
TURN = [(2.0 + 0.4 * np.sin(a), 0.4 - 0.4 * np.cos(a)) for a in np.linspace(0.0, np.pi, 7)]
HAIRPIN = [(0.0, 0.0), (0.7, 0.0), (1.4, 0.0), *TURN, (1.4, 0.8), (0.7, 0.8), (0.0, 0.8)]
NARROWING = [*HAIRPIN[:-3], (1.4, 0.75), (0.7, 0.6), (0.0, 0.4)]
SHAPE = st.lists(st.floats(-0.4, 0.4), min_size=4, max_size=7)


def wavy(offsets: list[float]) -> Path:
    return through([(float(i), y) for i, y in enumerate(offsets)], 1.0, FORCE)


@cache
def hairpin() -> Path:
    path = through(HAIRPIN, 1.0, FORCE)
    check(path)
    return path


def brute_force(p_H: Array, path: Path, lo: float = 0.0, hi: float = 1.0) -> tuple[float, float]:
    s = np.linspace(lo, hi, 20001)
    d = norm((path.p(s) - p_H)[:, :2])
    return float(s[np.argmin(d)]), float(np.min(d))


@pytest.mark.parametrize("name", ["paper", "straight", "s_bend"])
def test_files_pass_through_their_waypoints_by_arc_length(name: str) -> None:
    path = read(ideal.PATHS / f"{name}.toml", 1.2)
    assert path.p(0.0) == pytest.approx([*path.waypoints_m[0], 1.2])
    assert path.p(1.0) == pytest.approx([*path.waypoints_m[-1], 1.2])
    for waypoint in path.waypoints_m:
        assert brute_force(np.append(waypoint, 0.0), path)[1] < 2e-4


def test_the_papers_path_has_the_stated_shape() -> None:
    path = ideal.paper_path()
    s = np.linspace(0.0, 1.0, 4001)
    assert path.length_m == pytest.approx(4.17, abs=0.005)
    assert 1.0 / np.max(np.abs(path.curvature(s))) == pytest.approx(2.5, abs=0.03)
    post = path.obstacles[0]
    assert np.min(np.hypot(*(path.p(s)[:, :2] - (post.x_m, post.y_m)).T)) == pytest.approx(0.5, abs=0.005)


@given(SHAPE)
def test_s_is_arc_length_to_a_millionth(offsets: list[float]) -> None:
    path = wavy(offsets)
    s = np.linspace(0.0, 1.0, 20001)
    pieces = norm(np.diff(path.p(s), axis=0))
    assert np.max(np.abs(np.append(0.0, np.cumsum(pieces)) / path.length_m - s)) < 1e-6


@pytest.mark.parametrize("name", ["paper", "straight", "s_bend"])
def test_the_files_paths_are_by_arc_length_to_a_millionth(name: str) -> None:
    """Against adaptive quadrature of the spline's speed, which knows nothing of u(s)."""
    path = read(ideal.PATHS / f"{name}.toml", 1.0)
    knots = np.append(0.0, np.cumsum(np.hypot(*np.diff(path.waypoints_m, axis=0).T)))
    spline = CubicSpline(knots / knots[-1], path.waypoints_m, bc_type="not-a-knot")
    for s in np.linspace(0.05, 1.0, 8):
        nearest: Any = minimize_scalar(
            lambda u, s=s: float(np.hypot(*(spline(u) - path.p(s)[:2]))), bounds=(0.0, 1.0), options={"xatol": 1e-12}
        )
        arc = quad(lambda u: float(np.hypot(*spline(u, 1))), 0.0, nearest.x, epsabs=1e-10, limit=200)[0]
        assert arc / path.length_m == pytest.approx(s, abs=1e-6)


@given(st.lists(st.tuples(st.floats(0.2, 2.0), st.floats(-1.0, 1.0)), min_size=3, max_size=9))
def test_the_spline_is_scipys_to_rounding(steps: list[tuple[float, float]]) -> None:
    knots, values = np.cumsum([step for step, _ in steps]), np.array([(y, y * y - step) for step, y in steps])
    ours, scipys = Cubic(knots, values, not_a_knot(knots, values)), CubicSpline(knots, values, bc_type="not-a-knot")
    u = np.linspace(knots[0], knots[-1], 50)
    for found, right in zip(ours.sampled(u), (scipys(u), scipys(u, 1)), strict=True):
        assert found == pytest.approx(right, rel=1e-9, abs=1e-9)
    first = [row[:2] for row in ours.at(float(u[7]))]
    assert np.transpose(first) == pytest.approx(np.array([scipys(u[7]), scipys(u[7], 1)]), rel=1e-9, abs=1e-9)


@given(SHAPE, st.floats(0.001, 0.999))
def test_tangent_normal_and_curvature_are_derivatives(offsets: list[float], s: float) -> None:
    path, h = wavy(offsets), 1e-5
    step = 2 * h * path.length_m
    assert (path.p(s + h) - path.p(s - h)) / step == pytest.approx(path.t_hat(s), abs=1e-5)
    turn = (path.t_hat(s + h) - path.t_hat(s - h)) / step
    assert turn == pytest.approx(path.curvature(s) * path.normal(s), abs=2e-3 * (1 + abs(float(path.curvature(s)))))
    assert np.cross(path.t_hat(s), path.normal(s)) == pytest.approx([0.0, 0.0, 1.0])


@given(SHAPE)
def test_curvature_has_no_jump(offsets: list[float]) -> None:
    path = wavy(offsets)
    curvature = path.curvature(np.linspace(0.0, 1.0, 8001))
    finer = path.curvature(np.linspace(0.0, 1.0, 16001))
    assert np.max(np.abs(np.diff(finer))) < 0.75 * np.max(np.abs(np.diff(curvature))) + 1e-9


@given(SHAPE, st.floats(-2.0, 8.0), st.floats(-2.0, 2.0))
def test_projection_is_the_global_minimum(offsets: list[float], x: float, y: float) -> None:
    path, p_H = wavy(offsets), np.array([x, y, 1.0])
    found = norm((path.p(project(p_H, path)) - p_H)[:2])
    assert found <= brute_force(p_H, path)[1] + 1e-6


@given(SHAPE, st.floats(0.0, 1.0), st.floats(-0.1, 0.1))
def test_projection_finds_the_foot_of_the_normal(offsets: list[float], s: float, aside: float) -> None:
    path = wavy(offsets)
    assume(np.max(np.abs(path.curvature(np.linspace(0.0, 1.0, 501)))) < 5.0)
    s_star = project(path.p(s) + aside * path.normal(s), path, s)
    assert float(s_star) == pytest.approx(s, abs=1e-6)


@given(st.lists(st.tuples(st.floats(-1.0, 4.0), st.floats(-1.0, 2.0)), min_size=2, max_size=5), st.floats(0.0, 1.0))
def test_batches_equal_single_calls_within_the_window(points: list[tuple[float, float]], guess: float) -> None:
    path = hairpin()
    p_H = np.array([(x, y, 1.0) for x, y in points])
    together = project(p_H, path, np.full(len(points), guess), 0.5)
    assert together == pytest.approx([float(project(p, path, guess, 0.5)) for p in p_H])
    assert np.all(np.abs(together - guess) * path.length_m <= 0.5 + 1e-9)


@given(SHAPE, st.floats(0.0, 1.0), st.floats(-1.0, 1.0), vectors(0.05, 2))
def test_projection_is_continuous_within_reach_of_the_path(
    offsets: list[float], s: float, aside: float, move: Array
) -> None:
    """Nearer than the radius of curvature R and half the way to the next branch: s* moves at most 1/(1 - d/R) as far."""
    path = wavy(offsets)
    radius = 1.0 / max(float(np.max(np.abs(path.curvature(np.linspace(0.0, 1.0, 1001))))), 1e-3)
    far = 0.5 * min(radius, 0.3) * abs(aside) + float(norm(move))  # of either hand from the path, at most
    assume(far < min(0.8 * radius, 0.5 * clearance(path)))
    before = path.p(s) + 0.5 * min(radius, 0.3) * aside * path.normal(s)
    moved = abs(float(project(before + np.append(move, 0.0), path)) - float(project(before, path))) * path.length_m
    assert moved <= norm(move) / (1.0 - far / radius) + 2e-6


def clearance(path: Path) -> float:
    """Smallest distance between points further apart along the path than 0.9 m."""
    p = path.p(np.linspace(0.0, 1.0, 151))[:, :2]
    apart = np.abs(np.subtract.outer(np.arange(151), np.arange(151))) * path.length_m / 150 > 0.9
    return float(np.min(norm(p[:, None] - p[None, :])[apart]))


@settings(max_examples=10)
@given(st.floats(0.1, 1.5))
def test_between_two_legs_argmin_jumps_and_the_guard_does_not(x: float) -> None:
    """G4: two hands 1 µm apart, on either side of the middle between the legs of a hairpin."""
    path = hairpin()

    def gap(y: float) -> float:
        out, back = (brute_force(np.array([x, y, 1.0]), path, *half)[1] for half in ((0.0, 0.5), (0.5, 1.0)))
        return out - back

    y = cast(float, brentq(gap, 0.3, 0.5, xtol=1e-9))
    hands = [np.array([x, y + side, 1.0]) for side in (-5e-7, 5e-7)]
    free = [float(project(hand, path)) for hand in hands]
    assert (free[1] - free[0]) * path.length_m > 1.2
    for branch in free:
        kept = [float(project(hand, path, branch, 0.5)) for hand in hands]
        assert kept == pytest.approx([branch] * 2, abs=1e-5)


def test_at_the_centre_of_a_bend_even_the_guard_jumps_and_guiding_walks() -> None:
    """The limit of G4's guard: 0.4 m inside the bend every point of it is near; s* is then bounded by its rate only."""
    path, around = hairpin(), np.array([2.0, 0.4, 1.0])
    middle = float(project(around + [0.3, 0.0, 0.0], path))
    hands = [
        around + 1e-3 * np.array([np.cos(a), np.sin(a), 0.0]) for a in np.linspace(0.0, math.tau, 24, endpoint=False)
    ]
    jumps = [float(project(hand, path, middle, 0.5)) for hand in hands]
    assert np.ptp(jumps) * path.length_m > 0.5
    state = guiding.State(middle, 1.0)
    for hand in hands:
        before = float(state.s)
        x = guiding.Input(hand, hand + [0.0, 0.0, 1.0], True, True)
        state, _ = guiding.step(state, x, 0.01, path, ideal.GUIDING, ideal.CABLE)
        assert abs(float(state.s) - before) * path.length_m <= ideal.GUIDING.s_rate_max_mps * 0.01 + 1e-12


@given(st.floats(0.1, 1.5), st.floats(0.45, 0.7))
def test_the_guard_keeps_s_on_its_branch_of_a_hairpin(x: float, y: float) -> None:
    """G4: a hand that strays from the outward leg towards the way back."""
    path = hairpin()
    p_H, outward = np.array([x, y, 1.0]), x / path.length_m
    assert project(p_H, path) > 0.5  # argmin has jumped to the way back
    assert float(project(p_H, path, outward, 0.5)) == pytest.approx(outward, abs=0.05)


def test_paths_that_cannot_guide_are_refused_by_name(tmp_path: object) -> None:
    cases = {
        "waypoints_m = [[0, 0], [1, 0]]": "at least 3 points",
        "waypoints_m = [[0, 0], [0.1, 0], [0.2, 0]]": "at least 0.5 m",
        "waypoints_m = [[0, 0], [0, 0], [1, 0]]": "are the same",
        "waypoints_m = [[0, 0], [2, 0], [2, 2], [1, 1], [1, -2]]": "crosses itself",
        "waypoints_m = [[0, 0], [2, 0], [2.3, 0.2], [2, 0.4], [0, 0.4]]": "m, at least 0.3 m",
        f"waypoints_m = {[[float(x), float(y)] for x, y in NARROWING]}": "from itself, at least 0.6 m",
        "waypoints_m = [[0, 0], [1, nan], [2, 0]]": "finite",
        'waypoints_m = "round"': "a list of",
        "waypoints = [[0, 0], [1, 0], [2, 0]]": "waypoints = ",
    }
    force = "[force]\nf_start_N = 0.75\nf_max_N = 1.5\nramp_up_fraction = 0.1\nramp_down_fraction = 0.15\n"
    for line, expected in cases.items():
        refused(tmp_path, f'name = "x"\n{line}\n{force}', expected)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("f_start_N = 0.75", "f_start_N = 0.0"), "force.f_start_N = 0.0"),
        (("ramp_down_fraction = 0.15", "ramp_down_fraction = 0"), "force.ramp_down_fraction = 0.0"),
        (("f_max_N = 1.5", "f_max_N = 0.5"), "force.f_max_N = 0.5"),
        (("ramp_up_fraction = 0.1", "ramp_up_fraction = 0.9"), "force.ramp_up_fraction = 0.9"),
        (("ramp_up_fraction = 0.1", "ramp_up_fraction = inf"), "force.ramp_up_fraction = inf"),
        (("f_max_N = 1.5", "f_end_N = 0.2"), "f_max_N"),
        (("[force]", "[other]"), "other"),
    ],
)
def test_forces_that_cannot_guide_are_refused_by_name(tmp_path: object, change: tuple[str, str], expected: str) -> None:
    text = (
        'name = "x"\nwaypoints_m = [[0, 0], [1, 0], [2, 0]]\n[force]\nf_start_N = 0.75\nf_max_N = 1.5\n'
        "ramp_up_fraction = 0.1\nramp_down_fraction = 0.15\n"
    )
    refused(tmp_path, text.replace(*change), expected)


def refused(folder: object, text: str, expected: str) -> None:
    file = ideal.File(str(folder)) / "bad.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"bad\.toml") as caught:
        read(file, 1.0)
    assert expected in str(caught.value)
