"""Our frames and the autopilot's: one map each way, right-handed on both sides, nothing mirrored."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas import frames
from services.physics import Array, quaternion_product, rotate, rotation_matrix, yaw_from
from tests.laws.strategies import QUATERNIONS, vectors

EAST, NORTH, UP = np.eye(3)
VECTORS = vectors(10.0)
HEADINGS = st.floats(-np.pi, np.pi)


def level(yaw: float) -> Array:
    """q_WB of a level vehicle that heads `yaw` from x, anticlockwise."""
    return np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])


def same_attitude(a: Array, b: Array) -> bool:
    """q and -q turn vectors alike."""
    return bool(np.allclose(rotation_matrix(a), rotation_matrix(b), atol=1e-12))


def test_the_axes_by_name() -> None:
    """North is our y, east our x, up is minus down; forward stays, left is minus right."""
    assert np.array_equal(frames.ned_from_enu(NORTH), [1, 0, 0])
    assert np.array_equal(frames.ned_from_enu(EAST), [0, 1, 0])
    assert np.array_equal(frames.ned_from_enu(UP), [0, 0, -1])
    assert np.array_equal(frames.frd_from_flu(np.array([1.0, 2.0, 3.0])), [1, -2, -3])


@given(VECTORS)
def test_there_and_back(v: Array) -> None:
    assert np.array_equal(frames.enu_from_ned(frames.ned_from_enu(v)), v)
    assert np.array_equal(frames.ned_from_enu(frames.enu_from_ned(v)), v)
    assert np.array_equal(frames.flu_from_frd(frames.frd_from_flu(v)), v)


@given(VECTORS, VECTORS)
@pytest.mark.parametrize("there", [frames.ned_from_enu, frames.frd_from_flu])
def test_both_worlds_are_right_handed(there: Callable[[Array], Array], a: Array, b: Array) -> None:
    """A cross product is a cross product on either side: rates and torques need no other sign than vectors."""
    assert there(np.cross(a, b)) == pytest.approx(np.cross(there(a), there(b)), abs=1e-9)
    assert there(a) @ there(b) == pytest.approx(a @ b)


@given(QUATERNIONS, VECTORS)
def test_an_attitude_turns_the_same_arrow_whatever_world_it_is_told_in(q_NED_FRD: Array, v_B: Array) -> None:
    """FLU to FRD, turned there, NED to ENU: that is what q_WB does to a body vector."""
    round_trip = frames.enu_from_ned(rotate(q_NED_FRD, frames.frd_from_flu(v_B)))
    assert rotate(frames.q_enu_flu_from_ned_frd(q_NED_FRD), v_B) == pytest.approx(round_trip, abs=1e-9)


@given(QUATERNIONS, VECTORS)
def test_and_the_other_way(q_WB: Array, v_FRD: Array) -> None:
    round_trip = frames.ned_from_enu(rotate(q_WB, frames.flu_from_frd(v_FRD)))
    assert rotate(frames.q_ned_frd_from_enu_flu(q_WB), v_FRD) == pytest.approx(round_trip, abs=1e-9)


@given(QUATERNIONS)
def test_attitudes_there_and_back_stay_unit(q: Array) -> None:
    there = frames.q_ned_frd_from_enu_flu(q)
    assert np.sum(there**2) == pytest.approx(1.0)
    assert same_attitude(frames.q_enu_flu_from_ned_frd(there), q)


@given(QUATERNIONS, QUATERNIONS)
def test_turning_further_is_the_same_further(q: Array, dq_B: Array) -> None:
    """q ⊗ dq in our body is q ⊗ dq in the autopilot's, the turn's axis told in FRD."""
    dq_FRD = np.concatenate((dq_B[:1], frames.frd_from_flu(dq_B[1:])))
    ours = frames.q_ned_frd_from_enu_flu(quaternion_product(q, dq_B))
    assert same_attitude(ours, quaternion_product(frames.q_ned_frd_from_enu_flu(q), dq_FRD))


def test_on_the_pad_facing_north() -> None:
    """The autopilot's identity: nose north, level. Ours: a quarter turn from x to y."""
    assert same_attitude(frames.q_enu_flu_from_ned_frd(np.array([1.0, 0.0, 0.0, 0.0])), level(np.pi / 2))


@pytest.mark.parametrize(
    ("ours", "theirs"), [(0.0, np.pi / 2), (np.pi / 2, 0.0), (np.pi, -np.pi / 2), (-np.pi / 2, np.pi)]
)
def test_headings_by_name(ours: float, theirs: float) -> None:
    """East, north, west, south."""
    assert frames.yaw_ned_from_enu(ours) == pytest.approx(theirs, abs=1e-12)


@given(HEADINGS)
def test_the_heading_is_its_own_inverse_and_agrees_with_the_attitude(yaw: float) -> None:
    theirs = frames.yaw_ned_from_enu(yaw)
    assert -np.pi <= theirs <= np.pi
    back = frames.yaw_ned_from_enu(theirs)
    assert np.exp(1j * back) == pytest.approx(np.exp(1j * yaw))
    q = frames.q_ned_frd_from_enu_flu(level(yaw))
    assert np.exp(1j * float(yaw_from(q))) == pytest.approx(np.exp(1j * theirs))


def test_many_at_once_are_one_by_one() -> None:
    v, q = np.arange(12.0).reshape(4, 3), np.stack([level(a) for a in (0.1, 1.0, 2.0, 3.0)])
    assert np.array_equal(frames.ned_from_enu(v), [frames.ned_from_enu(row) for row in v])
    assert np.array_equal(frames.frd_from_flu(v), [frames.frd_from_flu(row) for row in v])
    assert frames.q_enu_flu_from_ned_frd(q) == pytest.approx(
        np.stack([frames.q_enu_flu_from_ned_frd(row) for row in q])
    )
