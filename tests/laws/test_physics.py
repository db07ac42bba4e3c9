"""Quaternions and the few vector operations all laws stand on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from services import physics
from services.physics import Array
from tests.laws.strategies import DT, QUATERNIONS, vectors

VECTOR = vectors(3.0)


def scipy_rotation(q_wxyz: Array) -> Rotation:
    return Rotation.from_quat(np.roll(q_wxyz, -1))


@given(QUATERNIONS, VECTOR)
def test_rotate_agrees_with_scipy(q: Array, v: Array) -> None:
    assert physics.rotate(q, v) == pytest.approx(scipy_rotation(q).apply(v), abs=1e-9)
    assert physics.rotate(physics.conjugate(q), physics.rotate(q, v)) == pytest.approx(v, abs=1e-9)


@given(QUATERNIONS, QUATERNIONS, VECTOR)
def test_a_product_rotates_by_the_right_factor_first(a: Array, b: Array, v: Array) -> None:
    one_after_the_other = physics.rotate(a, physics.rotate(b, v))
    assert physics.rotate(physics.quaternion_product(a, b), v) == pytest.approx(one_after_the_other, abs=1e-9)


@given(QUATERNIONS)
def test_rotation_matrices_are_rotations(q: Array) -> None:
    R = physics.rotation_matrix(q)
    assert np.max(np.abs(R @ R.T - np.eye(3))) < 1e-9
    assert np.linalg.det(R) == pytest.approx(1.0)


@given(QUATERNIONS, vectors(10.0), DT)
def test_attitude_integrates_exactly(q: Array, omega: Array, dt: float) -> None:
    after = physics.integrate_attitude(q, omega, dt)
    expected = scipy_rotation(q) * Rotation.from_rotvec(omega * dt)
    assert physics.rotation_matrix(after) == pytest.approx(expected.as_matrix(), abs=1e-9)
    halves = physics.integrate_attitude(physics.integrate_attitude(q, omega, dt / 2), omega, dt / 2)
    assert after == pytest.approx(halves, abs=1e-9)


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.0, 3.0))
def test_yaw_is_the_heading_of_x(yaw: float, pitch: float, roll: float) -> None:
    x, y, z, w = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()
    assert physics.yaw_from(np.array([w, x, y, z])) == pytest.approx(yaw, abs=1e-6)


@given(VECTOR, st.floats(0.01, 5.0))
def test_saturate_shortens_and_keeps_direction(v: Array, limit: float) -> None:
    out = physics.saturate(v, limit)
    assert float(physics.norm(out)) <= limit * (1 + 1e-12)
    assert out * physics.norm(v) == pytest.approx(v * physics.norm(out), abs=1e-9)
    if physics.norm(v) <= limit:
        assert out == pytest.approx(v)


@given(st.floats(0.1, 500.0), DT, DT)
def test_low_pass_steps_compose(rate: float, a: float, b: float) -> None:
    left_over = (1 - physics.low_pass_gain(rate, a)) * (1 - physics.low_pass_gain(rate, b))
    assert 1 - left_over == pytest.approx(physics.low_pass_gain(rate, a + b), abs=1e-12)


def test_everything_broadcasts() -> None:
    rng = np.random.default_rng(5)
    q = rng.normal(size=(2, 4, 4))
    q /= physics.norm(q)[..., None]
    v = rng.normal(size=(2, 4, 3))
    together = physics.rotate(physics.integrate_attitude(q, v, 0.01), v)
    alone = [
        [physics.rotate(physics.integrate_attitude(q[i, j], v[i, j], 0.01), v[i, j]) for j in range(4)] for i in (0, 1)
    ]
    assert together == pytest.approx(np.array(alone))
    assert physics.norm(v).shape == (2, 4)


@given(st.lists(VECTOR, min_size=1, max_size=3))
def test_taken_apart_and_put_together_it_is_the_same(crowd: list[Array]) -> None:
    for v in (crowd[0], np.array(crowd)):
        np.testing.assert_array_equal(physics.vector(*physics.components(v)), v)
    x, y, _ = physics.components(np.array(crowd))
    assert physics.vector(1.0, x, y).shape == physics.vector(x, y, 1.0).shape == (len(crowd), 3)


@given(st.lists(st.floats(-3.0, 3.0) | st.just(np.nan), min_size=1, max_size=5), st.floats(-1.0, 1.0))
def test_a_crowd_is_chosen_and_limited_as_each_alone(values: list[float], limit: float) -> None:
    together = np.array(values)
    for law in (
        lambda x: physics.at_least(x, limit),
        lambda x: physics.clamp(x, -0.5, 0.5 + abs(limit)),
        lambda x: physics.choose(x > limit, 2.0 * x, -1.0),
    ):
        np.testing.assert_array_equal(law(together), [law(value) for value in values])
    assert physics.anywhere(together > limit) is any(value > limit for value in values)
