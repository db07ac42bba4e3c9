"""The misprints E1 to E12, each against its right form, and the paper's walk on the ideal robot."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import root

from services import cable
from services.guiding_controller import guiding, maneuver
from services.physics import Array, norm
from services.recorder import lyapunov, metrics
from tests.laws import ideal

K_C, REST, F_Z, K_H, M_A, B_A = 150.0, 1.0, 1.0, 4.5, 0.8, 2.4
M_H, B_H = 5.0, 8.0
ELASTIC = cable.Cable(rest_length_m=REST, k_c_N_per_m=K_C)
F_REF = np.array([0.0, 0.0, F_Z])
K = np.array([K_H, K_H, 0.0])
P_H_REF = np.array([0.4, -0.3, 0.0])
P_R_REF = P_H_REF + cable.offset(F_REF, ELASTIC)
STILL = np.zeros(3)


def f_c(p_R: Array, p_H: Array) -> Array:
    return cable.force(p_R, p_H, STILL, STILL, ELASTIC)


def dynamics(x: Array, u_extra: Array = STILL, u_H: Array = STILL) -> Array:
    """closedLoopSystemDyn with regulation; the ground keeps the hand's z."""
    p_H, v_H, p_R, v_R = x.reshape(4, 3)
    f = f_c(p_R, p_H)
    a_H = (-B_H * v_H + f + u_H) / M_H * guiding.HORIZONTAL
    a_R = (-B_A * v_R - f + K * (P_R_REF - p_R) + F_REF + u_extra) / M_A
    return np.concatenate((v_H, a_H, v_R, a_R))


REGULATION = lyapunov.Regulation(M_H, B_H, M_A, K_H, ELASTIC, P_R_REF, F_REF)
DAMPING = np.full(3, B_A)


def states(x: Array) -> lyapunov.States:
    return lyapunov.States(*x.reshape(4, 3))


def V(x: Array) -> float:
    return float(lyapunov.V(states(x), REGULATION))


def dissipation(x: Array) -> float:
    return float(lyapunov.dissipated(states(x), DAMPING, REGULATION).total_W)


EQUILIBRIUM = np.concatenate((P_H_REF, STILL, P_R_REF, STILL))


def test_e1_the_robot_stands_above_the_hand() -> None:
    assert np.max(np.abs(dynamics(EQUILIBRIUM))) < 1e-12
    above = np.array([0.0, 0.0, F_Z / K_C + REST])
    assert norm((P_R_REF - P_H_REF) - above) < 1e-12
    assert norm((P_R_REF + P_H_REF) - above) > 0.5  # as printed, unless the goal is the origin


def test_e2_v_is_zero_at_the_equilibrium() -> None:
    assert V(EQUILIBRIUM) == pytest.approx(0.0, abs=1e-12)
    l_eq = F_Z / K_C + REST
    from_rest_length = quad(K_C.__mul__, 0.0, l_eq - REST)[0]
    printed = from_rest_length - l_eq * F_Z + F_Z**2 / K_C + 2 * REST * F_Z
    assert printed == pytest.approx(1.003, abs=5e-4)


STATES = st.lists(st.floats(-1.0, 1.0), min_size=12, max_size=12).map(np.array)


def plausible(z: Array) -> Array:
    """Hand in the plane at up to 1 m/s, robot up to 1 m about its place: slack states and taut ones (to 50 N)."""
    x = EQUILIBRIUM + z
    x[[2, 5]] = 0.0
    x[6:9] = x[0:3] + np.array([0.3 * z[6], 0.3 * z[7], 1.0 + 0.25 * z[8]])
    return x


@given(STATES)
def test_v_is_positive_away_from_the_equilibrium(z: Array) -> None:
    x = plausible(z)
    assert V(x) >= -1e-12
    if norm(x - EQUILIBRIUM) > 0.05:
        assert V(x) > 0.0


@given(STATES, st.lists(st.floats(-2.0, 2.0), min_size=6, max_size=6).map(np.array))
def test_e3_v_changes_by_supplied_less_dissipated_power(z: Array, u: Array) -> None:
    """Thm 1 to 4 in one line, by central difference along the flow."""
    x, u_R, u_H = plausible(z), u[:3], u[3:] * guiding.HORIZONTAL
    flow, h = dynamics(x, u_R, u_H), 1e-6
    v_dot = (V(x + h * flow) - V(x - h * flow)) / (2 * h)
    supplied = float(u_R @ x[9:] + u_H @ x[3:6])
    u_A = K * (P_R_REF - x[6:9]) + F_REF + u_R
    assert lyapunov.exogenous(u_A, x[6:9], REGULATION) == pytest.approx(u_R, abs=1e-12)
    predicted = float(lyapunov.rate(states(x), DAMPING, u_A, u_H, REGULATION))
    assert predicted == pytest.approx(supplied - dissipation(x), abs=1e-12 * (1.0 + dissipation(x)))
    assert v_dot == pytest.approx(predicted, abs=2e-4 * (1.0 + abs(supplied) + dissipation(x)))
    # hence <=; the printed >= fails whenever the hand moves
    robot_only = supplied - B_A * x[9:] @ x[9:] - u_H @ x[3:6]
    if B_H * x[3:6] @ x[3:6] - u_H @ x[3:6] > 1e-2:
        assert v_dot < robot_only


def resting_robot(p_H: Array) -> Array:
    """E5, solved: where the robot rests when the person stands at p_H."""

    def balance(p_R: Array) -> Array:
        return -f_c(p_R, p_H) + K * (P_R_REF - p_R) + F_REF

    solution = root(balance, p_H + cable.offset(F_REF, ELASTIC))
    assert solution.success
    return np.asarray(solution.x)


def test_e4_a_standing_person_pushes_against_the_cable() -> None:
    p_H = P_H_REF + np.array([-0.3, 0.1, 0.0])
    x = np.concatenate((p_H, STILL, resting_robot(p_H), STILL))
    pull = f_c(x[6:9], p_H) * guiding.HORIZONTAL
    assert norm(dynamics(x, u_H=-pull)) < 1e-8
    assert norm(dynamics(x, u_H=pull)) > 0.1  # as printed


def test_e5_the_printed_rest_of_the_robot_ignores_the_rest_length() -> None:
    p_H = P_H_REF + np.array([-0.3, 0.1, 0.0])
    right = resting_robot(p_H)
    signed = (K_C * p_H + K * P_R_REF + F_REF) / (K_C + K)
    printed = (K_C * p_H - K * P_R_REF + F_REF) / (K_C + K)
    assert norm(signed - right) > 0.7
    assert norm(printed - right) > 0.7
    assert norm(printed - signed) > 0.01


def test_e6_the_robot_stands_off_by_the_cable_not_inside_itself() -> None:
    path, s = ideal.paper_path(), np.array(0.5)
    p_R_d, f_d = maneuver.p_R_d(s, path, F_Z, ELASTIC), maneuver.f_d(s, path, F_Z)
    assert f_c(p_R_d, path.p(s)) == pytest.approx(f_d, abs=1e-9)
    u_A = guiding.paper_u_A(p_R_d, f_d, p_R_d, np.array(1.0), ideal.GUIDING)
    assert u_A == pytest.approx(f_d)
    misplaced = K * maneuver.p_R_d(s - p_R_d[0] / 10, path, F_Z, ELASTIC) + f_d  # "p_R^d(s* - p_R)"
    assert norm(misplaced - f_d) > 1.0


def test_e7_the_error_is_the_offset_at_the_crossing_of_the_normal() -> None:
    path, s = ideal.paper_path(), np.array([0.25, 0.5, 0.75])
    along = np.linspace(0.0, 1.0, 500)
    walk = path.p(along) + 0.04 * path.normal(along)
    assert metrics.path_error(walk, path, s) == pytest.approx([0.04] * 3, abs=1e-4)
    product = np.sum((walk[:, None] - path.p(s)) * path.normal(s), axis=-1)
    assert np.max(np.abs(np.min(product, axis=0) - 0.04)) > 0.3  # as printed: the point furthest to the right


def test_e8_the_standard_deviation_has_a_root() -> None:
    runs = np.random.default_rng(1).normal(0.0, 0.05, (8, 40))
    assert metrics.std_over_runs(runs) == pytest.approx(np.std(runs, axis=0, ddof=1))
    printed = np.sum((np.mean(runs, axis=0) - runs) ** 2, axis=0) / 7
    assert np.max(printed) < 0.02 < np.min(metrics.std_over_runs(runs))


@given(STATES)
def test_e9_the_cable_lengthens_along_itself(z: Array) -> None:
    x, h = plausible(z), 1e-6
    l_c, rate = x[6:9] - x[:3], x[9:] - x[3:6]
    by_difference = (norm(l_c + h * rate) - norm(l_c - h * rate)) / (2 * h)
    assert by_difference == pytest.approx(l_c @ rate / norm(l_c), abs=1e-7)


def test_e9_a_robot_that_circles_the_hand_does_not_stretch_the_cable() -> None:
    p_R, v_R = np.array([0.0, 0.0, 1.01]), np.array([1.0, 0.0, 0.0])
    damped = cable.Cable(rest_length_m=REST, k_c_N_per_m=K_C, d_c_Ns_per_m=1.0)
    assert cable.force(p_R, STILL, v_R, STILL, damped) == pytest.approx(f_c(p_R, STILL))


@given(STATES)
def test_e10_the_gradient_of_v2_needs_the_taut_cable(z: Array) -> None:
    x, h = plausible(z), 1e-6
    l_c = x[6:9] - x[:3]

    def v2(v: Array) -> float:
        return float(cable.energy(norm(v), ELASTIC) - v @ F_REF)

    gradient = np.array([(v2(l_c + h * e) - v2(l_c - h * e)) / (2 * h) for e in np.eye(3)])
    assert gradient == pytest.approx(f_c(x[6:9], x[:3]) - F_REF, abs=1e-3)
    if norm(l_c) < REST - 1e-5:  # the slack set's, where no point is stationary
        assert gradient == pytest.approx(-F_REF, abs=1e-6)


def test_e11_the_distance_to_the_path_ends_at_zero() -> None:
    walk = ideal.paper_walk()
    path = ideal.paper_path()
    ends = norm(walk.p_H - path.p(walk.s))
    assert np.max(ends) > 0.04
    assert ends[-1] < 0.01
    assert np.all(np.diff(ends[walk.t_s > 30.0]) < 0.0)


@given(st.floats(0.5, 500.0), st.floats(0.1, 5.0), st.floats(0.0, 100.0))
def test_e12_the_energy_is_bounded_below_with_half_epsilon(k_c: float, rest: float, length: float) -> None:
    """∫ t_c >= ε/2 l² + γ l + const holds with ε = k_c; with ε for ε/2 it fails for every long cable."""
    p = cable.Cable(rest_length_m=rest, k_c_N_per_m=k_c)
    gamma, const = -k_c * rest, 0.5 * k_c * rest**2

    def bound(factor: float, at: float) -> float:
        return factor * k_c * at**2 + gamma * at

    assert cable.energy(np.array(length), p) >= bound(0.5, length) - 1e-9 * k_c * (1 + length**2)
    far = 10.0 * rest
    assert cable.energy(np.array(far), p) < bound(1.0, far) - const


def test_the_walk_reproduces_the_paper() -> None:
    walk, path = ideal.paper_walk(), ideal.paper_path()
    error = metrics.reference_error(walk.p_H, path.p(walk.s))
    arrival = metrics.arrival_time(walk.t_s, walk.p_H, path, 0.10)
    before = walk.t_s <= arrival
    print(f"mean {100 * np.mean(error[before]):.2f} cm, max {100 * np.max(error):.2f} cm, {arrival:.1f} s")
    assert np.mean(error[before]) == pytest.approx(0.023, abs=0.003)
    assert np.max(error) == pytest.approx(0.047, abs=0.003)
    assert arrival == pytest.approx(30.0, abs=2.0)
    taut = walk.t_s > 4.0
    assert metrics.slack_fraction((walk.p_R - walk.p_H)[taut], REST) == 0.0


def test_the_walk_drifts_to_the_outside_of_the_bend() -> None:
    walk, path = ideal.paper_walk(), ideal.paper_path()
    s = np.linspace(0.2, 0.8, 61)
    outside = -np.sign(path.curvature(s)) * metrics.path_error(walk.p_H, path, s)
    assert np.min(outside) > 0.0
