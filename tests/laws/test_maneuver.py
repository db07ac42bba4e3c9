"""The force along the path, and the robot's place that carries it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services import cable
from services.guiding_controller import maneuver
from services.guiding_controller.path import Trapezoid
from services.physics import norm
from tests.laws import ideal

PROFILES = st.builds(
    Trapezoid,
    f_start_N=st.floats(0.1, 1.0),
    f_max_N=st.floats(1.0, 3.0),
    ramp_up_fraction=st.floats(0.0, 0.5),
    ramp_down_fraction=st.floats(0.01, 0.5),
)
S = np.linspace(0.0, 1.0, 1001)
ZERO = np.zeros(3)


@given(PROFILES)
def test_profile_pulls_until_the_end_and_not_there(profile: Trapezoid) -> None:
    f = maneuver.f_xy(S, profile)
    assert np.all(f[:-1] > 0.0)
    assert f[-1] == 0.0
    assert np.max(f) <= profile.f_max_N
    steepest = max(profile.f_max_N / profile.ramp_down_fraction, profile.f_max_N / max(profile.ramp_up_fraction, 1e-3))
    assert np.max(np.abs(np.diff(f))) <= steepest * S[1] * 1.001
    if profile.ramp_up_fraction > 0:
        assert f[0] == pytest.approx(profile.f_start_N)


@given(PROFILES, st.floats(0.0, 1.0, exclude_max=True))
def test_the_pull_is_positive_for_every_s_before_the_end(profile: Trapezoid, s: float) -> None:
    """Down to the last number below 1; and continuous there, so that it ends without a step."""
    assert 0.0 < maneuver.f_xy(s, profile) <= profile.f_max_N
    assert maneuver.f_xy(float(np.nextafter(1.0, 0.0)), profile) > 0.0
    assert maneuver.f_xy(1.0, profile) == 0.0


@given(st.floats(0.0, 1.0), st.floats(0.2, 3.0), st.floats(20.0, 1000.0))
def test_the_robot_at_its_place_carries_the_force_in_the_cable(s: float, f_z: float, k_c: float) -> None:
    path, p = ideal.paper_path_cached(), cable.Cable(rest_length_m=1.0, k_c_N_per_m=k_c)
    at = np.array(s)
    p_R_d, f_d = maneuver.p_R_d(at, path, f_z, p), maneuver.f_d(at, path, f_z)
    assert cable.force(p_R_d, path.p(at), ZERO, ZERO, p) == pytest.approx(f_d, abs=1e-9)
    assert f_d[2] == f_z
    assert float(norm(f_d[:2])) == pytest.approx(float(maneuver.f_xy(at, path.force)))


def test_at_full_pull_the_drone_is_ahead_at_face_height() -> None:
    """G10: 0.82 m ahead of and 0.58 m above the hand (with the cable's stretch)."""
    l_c = cable.offset(np.array([1.5, 0.0, 1.0]), ideal.CABLE)
    assert l_c == pytest.approx([0.84, 0.0, 0.56], abs=0.01)


def test_at_the_end_the_robot_stands_above_the_hand() -> None:
    path, end = ideal.paper_path_cached(), np.array(1.0)
    l_c = maneuver.p_R_d(end, path, 1.0, ideal.CABLE) - path.p(end)
    assert l_c == pytest.approx([0.0, 0.0, 1.0 + 1.0 / 200.0])
