"""The route in position mode: over the start, and at the end away from the person, down, aside, whatever the path."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services import cable
from services.guiding_controller.path import Path, Trapezoid, through
from services.guiding_controller.path_file import read
from services.physics import Array, Z, norm
from services.safety_supervisor import distances
from services.safety_supervisor.distances import Envelope
from services.safety_supervisor.phases import Plan
from services.safety_supervisor.plan import hover, plan
from tests.laws import ideal

WEIGHT_N, BELOW_M, AWAY_M, ASIDE_M = 0.3, 0.1, 1.3, 0.7
PERSON = Envelope(head_above_hand_m=0.6, head_behind_hand_m=0.6, rotor_tip_m=0.19)
FORCE = Trapezoid(f_start_N=0.75, f_max_N=1.5, ramp_up_fraction=0.1, ramp_down_fraction=0.15)
PATHS = [read(file, ideal.PLANE_Z) for file in sorted(ideal.PATHS.glob("*.toml"))]
each_path = pytest.mark.parametrize("path", PATHS, ids=lambda path: path.name)
ANY_PATH = st.builds(
    lambda heading, bend: through(
        2.0 * np.array([[-1.0, 0.0], [0.0, bend], [1.0, 0.0]]) @ turn(heading)[:2, :2].T, ideal.PLANE_Z, FORCE
    ),
    st.floats(-np.pi, np.pi),
    st.floats(-0.4, 0.4),
)


def turn(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def route(path: Path) -> Plan:
    return plan(path, ideal.CABLE, WEIGHT_N, BELOW_M, AWAY_M, ASIDE_M)


def flown(path: Path) -> Array:
    """Points every few centimetres from above the end of the path to the last point of the route, (N, 3)."""
    corners = [hover(path.p(1.0), WEIGHT_N, ideal.CABLE), *route(path).clearing]
    share = np.linspace(0.0, 1.0, 41)[:, None]
    return np.concatenate([a + share * (b - a) for a, b in pairwise(corners)])


@given(st.floats(0.05, 0.5), ANY_PATH)
def test_hovering_it_carries_the_free_handle_just_where_it_was_said(weight_N: float, path: Path) -> None:
    p_H = path.p(0.3)
    f_c = cable.force(hover(p_H, weight_N, ideal.CABLE), p_H, np.zeros(3), np.zeros(3), ideal.CABLE)
    assert f_c == pytest.approx([0.0, 0.0, weight_N], abs=1e-9)


@each_path
def test_at_the_start_the_handle_hangs_below_the_hands_plane(path: Path) -> None:
    """Taking it is lifting it; and it is the handle over the start, not beside it."""
    handle = route(path).start - cable.offset(WEIGHT_N * Z, ideal.CABLE)
    assert handle == pytest.approx(path.p(0.0) - [0.0, 0.0, BELOW_M])


@given(ANY_PATH)
def test_the_vehicle_never_comes_back_over_the_person(path: Path) -> None:
    """The person stands at the end, facing along the path: the whole route is before them, never over the hand again."""
    ahead = (flown(path) - path.p(1.0)) @ path.t_hat(1.0)
    assert np.all(ahead >= -1e-9)
    assert np.all(ahead[41:] >= AWAY_M - 1e-9)


@given(ANY_PATH)
def test_head_and_hand_stay_clear_of_the_route(path: Path) -> None:
    """Nowhere nearer than where the walk ended: an arm's cable over the hand, more than half a metre from the head."""
    hand, facing = path.p(1.0), path.t_hat(1.0)
    low, high = np.full(3, -9.0), np.full(3, 9.0)
    near = distances.measure(flown(path), hand, facing, low, high, 9.0, PERSON)
    assert np.min(near.head) > 0.5
    assert np.min(near.hand) >= ideal.CABLE.rest_length_m
    coming_down = flown(path)[41:]
    assert np.min(norm((coming_down - hand)[:, :2])) >= AWAY_M - 1e-9


@given(ANY_PATH)
def test_it_comes_down_only_away_and_only_straight(path: Path) -> None:
    away, down, aside = route(path).clearing
    assert away[:2] == pytest.approx(down[:2])
    assert aside[2] == down[2] < ideal.CABLE.rest_length_m < away[2]


@given(ANY_PATH)
def test_g10_it_does_not_land_on_the_handle(path: Path) -> None:
    """The handle rests under `down`; moving aside drags it to the end of the cable's reach, outside the rotors."""
    _, down, aside = route(path).clearing
    reach = np.sqrt(ideal.CABLE.rest_length_m**2 - aside[2] ** 2)
    moved = norm(aside - down)
    assert moved == pytest.approx(ASIDE_M)
    assert moved > reach > PERSON.rotor_tip_m + 0.1


@given(ANY_PATH)
def test_aside_is_across_the_path_so_no_nearer_to_the_person(path: Path) -> None:
    _, down, aside = route(path).clearing
    assert (aside - down) @ path.t_hat(1.0) == pytest.approx(0.0, abs=1e-9)
    assert norm(aside - path.p(1.0)) > norm(down - path.p(1.0))


@each_path
def test_the_routes_of_our_paths_stay_in_the_hall_and_below_the_ceiling(path: Path) -> None:
    points = np.concatenate((flown(path), route(path).start[None]))
    assert np.all(points > [-4.0, -3.0, 0.0])
    assert np.all(points < [5.0, 3.0, ideal.PLANE_Z + ideal.CABLE.rest_length_m + 0.1])
