"""The set-point: the cable's pull is pushed back against, and nothing leaves the limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.physics import Array, norm
from services.px4_bridge.admittance import State
from services.px4_bridge.setpoint import Limits, setpoint

WIDE = Limits(a_xy_max_mps2=100.0, a_z_max_mps2=100.0, v_max_mps=100.0, step_max_m=100.0)
TIGHT = Limits(a_xy_max_mps2=3.0, a_z_max_mps2=2.0, v_max_mps=1.0, step_max_m=0.05)
VECTOR = st.lists(st.floats(-10.0, 10.0), min_size=3, max_size=3).map(np.array)


def state(p: Array, v: Array, a: Array) -> State:
    return State(p, v, a, np.array(9.0))


@given(VECTOR, VECTOR, st.floats(0.5, 3.0))
def test_with_feed_forward_the_vehicle_moves_as_the_filter_does(u_R: Array, f_c: Array, m_R: float) -> None:
    """G2: m_R v̇ = m_R a_sp - f_c must give v̇ = u_R; without the feed-forward it is off by f_c/m_R."""
    s = state(np.zeros(3), np.zeros(3), u_R)
    moved = setpoint(s, f_c, m_R, 1.0, s.p, WIDE).a - f_c / m_R
    assert moved == pytest.approx(u_R, abs=1e-9)
    assert setpoint(s, f_c, m_R, 0.0, s.p, WIDE).a == pytest.approx(u_R)


@given(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, st.floats(0.0, 1.0))
def test_limits_hold_and_say_so(p: Array, v: Array, a: Array, f_c: Array, p_last: Array, ff: float) -> None:
    out = setpoint(state(p, v, a), f_c, 0.8, ff, p_last, TIGHT)
    assert float(norm(out.a[:2])) <= 3.0 + 1e-9
    assert abs(out.a[2]) <= 2.0
    assert float(norm(out.v)) <= 1.0 + 1e-9
    assert float(norm(out.p - p_last)) <= 0.05 + 1e-9
    free = setpoint(state(p, v, a), f_c, 0.8, ff, p_last, WIDE)
    same = all(np.allclose(x, y, atol=1e-9) for x, y in zip(out[:3], free[:3], strict=True))
    assert bool(out.limited) != same
