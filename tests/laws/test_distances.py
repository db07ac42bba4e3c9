"""The clearances by hand-computed cases, and what is believed of the way the person faces."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.physics import Array, norm
from services.safety_supervisor import distances
from services.safety_supervisor.distances import TURN_M, Envelope
from tests.laws.strategies import vectors

P = Envelope(head_above_hand_m=0.6, head_behind_hand_m=0.6, rotor_tip_m=0.2)
LOW, HIGH, CEILING = np.array([-4.0, -3.0, 0.0]), np.array([5.0, 3.0, 3.0]), 2.2
EAST, NORTH = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
HAND = np.array([0.0, 0.0, 1.0])


def measured(p_R: Array, p_H: Array = HAND, ahead: Array = EAST) -> distances.Distances:
    return distances.measure(p_R, p_H, ahead, LOW, HIGH, CEILING, P)


def test_the_head_is_behind_and_above_the_hand() -> None:
    """Hand at 1 m, facing east: the head is at (-0.6, 0, 1.6); a tip 0.2 m from the centre."""
    assert measured(np.array([-0.6, 0.0, 2.6])).head == pytest.approx(1.0 - 0.2)
    assert measured(np.array([0.2, 0.0, 2.2])).head == pytest.approx(1.0 - 0.2)  # (0.8, 0, 0.6) away
    assert measured(np.array([0.0, 1.2, 2.2]), ahead=NORTH).head == pytest.approx(np.sqrt(1.8**2 + 0.6**2) - 0.2)


def test_g10_leading_and_overhead() -> None:
    """The paper's pull: 0.82 m ahead of and 0.58 m above the hand is level with the face, and clear of it."""
    leading = measured(HAND + [0.82, 0.0, 0.58])
    assert leading.head == pytest.approx(1.42 - 0.2, abs=0.001)
    assert leading.hand == pytest.approx(1.004, abs=0.001)
    overhead = measured(HAND + [0.0, 0.0, 1.0])
    assert overhead.head == pytest.approx(np.hypot(0.6, 0.4) - 0.2)


def test_facing_the_wrong_way_the_head_is_nearer() -> None:
    """Why the way the person faces matters: the same drone before or behind them."""
    ahead = HAND + [0.5, 0.0, 0.6]
    assert measured(ahead, ahead=EAST).head == pytest.approx(1.1 - 0.2)
    assert measured(ahead, ahead=-EAST).head == pytest.approx(0.1 - 0.2)


@pytest.mark.parametrize(
    ("p_R", "outside"),
    [
        ([0.0, 0.0, 1.5], -1.5),
        ([4.9, 0.0, 1.5], -0.1),
        ([5.3, 0.0, 1.5], 0.3),
        ([0.0, -3.4, 1.5], 0.4),
        ([0.0, 0.0, 3.1], 0.1),
        ([0.0, 0.0, -0.2], 0.2),
        ([5.3, 3.5, 1.5], 0.5),
    ],
)
def test_outside_is_the_worst_wall(p_R: list[float], outside: float) -> None:
    assert measured(np.array(p_R)).outside == pytest.approx(outside)


@pytest.mark.parametrize(("z", "above"), [(2.0, -0.2), (2.5, 0.3)])
def test_above_is_measured_from_the_ceiling(z: float, above: float) -> None:
    assert measured(np.array([0.0, 0.0, z])).above == pytest.approx(above)


@given(vectors(3.0), vectors(3.0), st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi), vectors(2.0))
def test_the_person_has_no_north(p_R: Array, p_H: Array, heading: float, turn: float, shift: Array) -> None:
    """Turned and shifted together, nobody is nearer to anything."""
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    one, other = measured(p_R, p_H, ahead), measured(R @ p_R + shift, R @ p_H + shift, R @ ahead)
    assert other.head == pytest.approx(one.head, abs=1e-9)
    assert other.hand == pytest.approx(one.hand, abs=1e-9)


@given(vectors(3.0), vectors(3.0), vectors(3.0))
def test_no_clearance_grows_faster_than_the_vehicle_moves(p_R: Array, p_H: Array, moved: Array) -> None:
    one, other = measured(p_R, p_H), measured(p_R + moved, p_H)
    assert all(abs(a - b) <= norm(moved) + 1e-9 for a, b in zip(one, other, strict=True))


def test_the_person_faces_the_drone_that_leads() -> None:
    assert distances.facing(EAST, HAND + [0.0, 0.8, 0.6], HAND) == pytest.approx(NORTH)
    assert distances.facing(EAST, HAND + [-0.3, 0.3, 5.0], HAND) == pytest.approx([-np.sqrt(0.5), np.sqrt(0.5), 0.0])


@given(st.floats(0.0, TURN_M * 0.999), st.floats(-np.pi, np.pi), st.floats(0.0, 2.0))
def test_overhead_the_person_faces_as_before(lead: float, angle: float, above: float) -> None:
    """Directly under the drone its direction is noise: at the end of the path nobody turns round."""
    p_R = HAND + [lead * np.cos(angle), lead * np.sin(angle), above]
    assert np.array_equal(distances.facing(EAST, p_R, HAND), EAST)


@given(vectors(2.0), vectors(2.0), st.floats(-np.pi, np.pi))
def test_facing_is_a_horizontal_direction_whatever_comes(p_R: Array, p_H: Array, heading: float) -> None:
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    now = distances.facing(ahead, p_R, p_H)
    assert now[2] == 0.0
    assert norm(now) == pytest.approx(1.0)


def test_all_at_once_is_one_by_one() -> None:
    p_R = np.linspace(-2.0, 3.0, 12).reshape(4, 3)
    ahead = np.stack((EAST, NORTH, -EAST, -NORTH))
    together = distances.measure(p_R, HAND, ahead, LOW, HIGH, CEILING, P)
    faces = distances.facing(ahead, p_R, HAND)
    for i in range(4):
        assert [row[i] for row in together] == pytest.approx(list(measured(p_R[i], HAND, ahead[i])))
        assert faces[i] == pytest.approx(distances.facing(ahead[i], p_R[i], HAND))
