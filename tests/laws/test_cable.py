"""The cable: it pulls along its line, never pushes, and its energy is what its force can do."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from services import cable
from services.physics import Array, norm
from tests.laws.strategies import UNIT, vectors

CABLES = st.builds(
    cable.Cable,
    rest_length_m=st.floats(0.3, 3.0),
    k_c_N_per_m=st.floats(20.0, 1000.0),
    d_c_Ns_per_m=st.floats(0.0, 5.0),
)
POINT, SPEED, ZERO = vectors(2.0), vectors(3.0), np.zeros(3)
FORCE = st.tuples(UNIT, st.floats(0.05, 20.0)).map(lambda v: v[0] * v[1])


@given(CABLES, POINT, POINT, SPEED, SPEED)
def test_it_pulls_the_handle_towards_the_robot_or_not_at_all(
    c: cable.Cable, p_R: Array, p_H: Array, v_R: Array, v_H: Array
) -> None:
    l_c = p_R - p_H
    f_c = cable.force(p_R, p_H, v_R, v_H, c)
    assert f_c @ l_c >= 0.0
    off_line = f_c * (l_c @ l_c) - l_c * (f_c @ l_c)
    assert np.max(np.abs(off_line)) <= 1e-9 * (1.0 + float(norm(f_c)) * (l_c @ l_c))
    if norm(l_c) <= c.rest_length_m:
        assert np.all(f_c == 0.0)


@given(CABLES, POINT, POINT)
def test_it_is_even_handed(c: cable.Cable, p_R: Array, p_H: Array) -> None:
    forwards, backwards = cable.force(p_R, p_H, ZERO, ZERO, c), cable.force(p_H, p_R, ZERO, ZERO, c)
    assert forwards == pytest.approx(-backwards)


@given(CABLES, FORCE, POINT)
def test_offset_inverts_the_force_and_hand_inverts_the_offset(c: cable.Cable, f_c: Array, p_H: Array) -> None:
    p_R = p_H + cable.offset(f_c, c)
    assert cable.force(p_R, p_H, ZERO, ZERO, c) == pytest.approx(f_c, rel=1e-6, abs=1e-8)
    assert cable.hand(p_R, f_c, c) == pytest.approx(p_H, abs=1e-9)


@given(CABLES, st.floats(0.0, 5.0))
def test_energy_is_the_integral_of_the_tension(c: cable.Cable, length: float) -> None:
    h = 1e-6
    assume(abs(length - c.rest_length_m) > h)
    slope = (cable.energy(np.array(length + h), c) - cable.energy(np.array(length - h), c)) / (2 * h)
    assert float(slope) == pytest.approx(float(cable.tension(np.array(length), 0.0, c)), rel=1e-5, abs=1e-5)


@given(CABLES, st.floats(0.0, 5.0), st.floats(-3.0, 3.0))
def test_damping_only_takes_energy(c: cable.Cable, length: float, rate: float) -> None:
    damped, plain = cable.tension(np.array(length), rate, c), cable.tension(np.array(length), 0.0, c)
    assert (damped - plain) * rate >= 0.0
    assert damped >= 0.0


def test_a_cable_of_no_length_does_not_divide_by_zero() -> None:
    c = cable.Cable(rest_length_m=1.0, k_c_N_per_m=200.0)
    assert np.all(cable.force(ZERO, ZERO, ZERO, ZERO, c) == 0.0)


@given(CABLES, st.lists(st.tuples(POINT, POINT), min_size=1, max_size=4))
def test_it_broadcasts(c: cable.Cable, ends: list[tuple[Array, Array]]) -> None:
    p_R, p_H = np.array([a for a, _ in ends]), np.array([b for _, b in ends])
    together = cable.force(p_R, p_H, 0.1 * p_H, ZERO, c)
    alone = [cable.force(a, b, 0.1 * b, ZERO, c) for a, b in ends]
    assert together == pytest.approx(np.array(alone))
