"""The calibration laws on data of which the truth is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.calibration import delay, handle, thrust
from services.calibration.fit import Unfit, lagged, least_squares, lowest
from services.calibration.thrust import Flight
from services.physics import GRAVITY_MPS2, integrate_attitude, rotate

DT_S = 0.004
CURVES = st.sampled_from((0.0, 0.1, 0.3, 0.6, 1.0))


def noise(*shape):
    return np.random.default_rng(4).standard_normal(shape)


def flight(
    mass_kg=0.8, max_N=15.7, curve=0.0, hanging_kg=0.03, steps=0.15, lag_s=0.05, k=0.0, volts=(12.0, 12.0), seconds=20.0
):
    """Hover with steps up and down of `steps` of its thrust; noise of the accelerometer as the vehicle's file has it."""
    n = round(seconds / DT_S)
    hover = (mass_kg + hanging_kg) * GRAVITY_MPS2
    wave = np.where(np.arange(n) * DT_S % 4.0 < 2.0, 1.0, -1.0)
    battery = np.linspace(volts[0], volts[1], n)
    wanted = hover * (1.0 + steps * wave) / (max_N * (battery / volts[0]) ** k)
    u = wanted if curve == 0.0 else (np.sqrt((1 - curve) ** 2 + 4 * curve * wanted) - (1 - curve)) / (2 * curve)
    mean, square = u, u**2 + 0.02**2
    real = np.stack((mean, square), axis=1) * ((battery / volts[0]) ** k)[:, None]
    real = lagged(real, DT_S, lag_s)
    T = max_N * ((1 - curve) * real[:, 0] + curve * real[:, 1])
    a_z = (T - hanging_kg * GRAVITY_MPS2) / mass_kg + 0.03 * noise(n)
    return Flight(DT_S, a_z, np.ones(n), mean, square, battery, np.ones(n, dtype=bool))


@settings(max_examples=15)
@given(mass=st.floats(0.5, 2.0), weight_ratio=st.floats(1.6, 3.0), curve=CURVES, lag_s=st.floats(0.0, 0.1))
def test_steps_up_and_down_give_scale_curve_and_lag(mass, weight_ratio, curve, lag_s):
    max_N = weight_ratio * mass * GRAVITY_MPS2
    found = thrust.thrust(flight(mass, max_N, curve, lag_s=lag_s), mass, 0.03)
    assert not found.kept_curve
    u = np.linspace(0.8, 1.2, 5) * 0.5
    true = max_N * ((1 - curve) * u + curve * u**2)
    model = found.max_thrust_N * ((1 - found.curve) * u + found.curve * u**2)
    assert model == pytest.approx(true, rel=0.01)
    assert found.error < 0.005
    assert found.lag_s == pytest.approx(lag_s, abs=0.02)


@given(mass=st.floats(0.5, 2.0), curve=CURVES)
@settings(max_examples=10)
def test_a_hover_gives_the_scale_of_a_known_curve(mass, curve):
    found = thrust.thrust(flight(mass, 20.0, curve, steps=0.005), mass, 0.03, curve)
    assert found.kept_curve
    assert found.max_thrust_N == pytest.approx(20.0, rel=0.005)


def test_a_wrong_mass_is_a_wrong_scale_and_a_shaken_flight_has_a_large_error():
    assert thrust.thrust(flight(0.8), 0.84, 0.03).max_thrust_N == pytest.approx(1.05 * 15.7, rel=0.01)
    shaken = flight(0.8)
    gusts = np.repeat(noise(len(shaken.a_z) // 50), 50)
    assert thrust.thrust(shaken._replace(a_z=shaken.a_z + 0.6 * gusts), 0.8, 0.03).error > 0.02


@pytest.mark.parametrize("k", [0.0, 1.0, 2.0])
def test_a_battery_that_sinks_shows_its_exponent(k):
    found = thrust.thrust(flight(k=k, volts=(12.6, 10.8)), 0.8, 0.03)
    assert found.voltage_exponent == pytest.approx(k, abs=0.05)
    assert found.error < 0.005


def test_what_is_not_free_flight_is_not_looked_at():
    held = flight()
    half = len(held.use) // 2
    pulled = held._replace(a_z=np.where(np.arange(2 * half) < half, held.a_z, 0.0), use=np.arange(2 * half) < half)
    assert thrust.thrust(pulled, 0.8, 0.03).max_thrust_N == pytest.approx(15.7, rel=0.01)
    with pytest.raises(Unfit, match="free flight"):
        thrust.thrust(held._replace(use=np.zeros(2 * half, dtype=bool)), 0.8, 0.03)


@given(mass=st.floats(0.5, 2.0))
@settings(max_examples=10)
def test_the_mass_comes_from_a_known_thrust(mass):
    hover = flight(mass, 30.0, steps=0.05, lag_s=0.0)
    found = thrust.mass([hover], [30.0 * hover.mean], [0.0], 0.03)
    assert found.mass_kg == pytest.approx(mass, rel=0.003)
    assert found.scale == 1.0


@given(mass=st.floats(0.6, 2.0), scale=st.floats(0.9, 1.1))
@settings(max_examples=10)
def test_two_hovers_with_a_mass_between_them_need_only_the_shape(mass, scale):
    bare, laden = flight(mass, 40.0, lag_s=0.0), flight(1.3 * mass, 40.0, lag_s=0.0)
    wrong = [scale * 40.0 * f.mean for f in (bare, laden)]
    found = thrust.mass([bare, laden], wrong, [0.0, 0.3 * mass], 0.03)
    assert found.mass_kg == pytest.approx(mass, rel=0.01)
    assert found.scale == pytest.approx(1.0 / scale, rel=0.01)


def attitudes(axes, n=300, tilt_rad=0.5):
    """Swings about the named axes, each with its own pace, (n, 4)."""
    t = np.linspace(0.0, 20.0, n)
    angles = np.zeros((n, 3))
    for axis in axes:
        angles[:, axis] = tilt_rad * np.sin((0.7 + 0.3 * axis) * t + axis)
    level = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    return integrate_attitude(level, angles, 1.0)


@given(offset=st.tuples(*[st.floats(-0.15, 0.15)] * 3), noise_mm=st.floats(0.0, 1.0))
@settings(max_examples=20)
def test_turning_the_handle_about_o_h_shows_where_it_is(offset, noise_mm):
    q, pivot = attitudes((0, 1, 2)), np.array([0.3, -0.2, 0.8])
    p = pivot - rotate(q, np.tile(offset, (len(q), 1))) + 1e-3 * noise_mm * noise(len(q), 3)
    found = handle.handle(p, q)
    assert found.offset == pytest.approx(offset, abs=1e-6 + 6e-4 * noise_mm)
    assert found.pivot == pytest.approx(pivot, abs=1e-6 + 6e-4 * noise_mm)
    assert found.left_m == pytest.approx(1e-3 * noise_mm * np.sqrt(3), rel=0.2, abs=1e-9)


@pytest.mark.parametrize(("axes", "tilt_rad"), [((), 0.5), ((2,), 0.5), ((0, 1, 2), 0.05)])
def test_a_handle_that_is_hardly_turned_or_about_one_axis_shows_nothing(axes, tilt_rad):
    q = attitudes(axes, tilt_rad=tilt_rad)
    with pytest.raises(Unfit, match="turned too little"):
        handle.handle(np.zeros((len(q), 3)), q)


def turning(seconds=20.0, swing=0.6):
    """Stamps at 250 Hz, mean body rates since the stamp before, and the attitude they lead to."""
    t = np.arange(0.0, seconds, DT_S)
    omega = swing * np.stack([np.sin(2.1 * t) + np.sin(0.6 * t), np.cos(2.7 * t), np.sin(1.3 * t + 1.0)], axis=1)
    q = [np.array([1.0, 0.0, 0.0, 0.0])]
    for rate in omega[1:]:
        q.append(integrate_attitude(q[-1], rate, DT_S))
    return t, omega, np.array(q)


@given(late_s=st.floats(-0.02, 0.2), bias=st.floats(-0.1, 0.1))
@settings(max_examples=8)
def test_the_delay_of_the_poses_is_found(late_s, bias):
    t, omega, q = turning()
    seen = integrate_attitude(q[::4], 0.001 * noise(len(q[::4]), 3), 1.0)
    found = delay.delay(t[::4] + late_s, seen, t, omega + bias)
    assert found.delay_s == pytest.approx(late_s, abs=0.001)
    assert found.sigma_s < 0.002
    assert abs(found.delay_s - late_s) < 5.0 * found.sigma_s + 5e-4


def test_a_vehicle_that_stands_still_shows_no_delay():
    t, omega, q = turning(swing=0.01)
    with pytest.raises(Unfit, match="turn it by hand"):
        delay.delay(t[::4], q[::4], t, omega)
    with pytest.raises(Unfit, match="needed"):
        delay.delay(t[:100:4], q[:100:4], t, omega)


def test_a_marker_body_that_stands_askew_leaves_much():
    t, omega, q = turning()
    askew = np.stack((omega[:, 1], -omega[:, 0], omega[:, 2]), axis=1)
    found = delay.delay(t[::4], q[::4], t, askew)
    assert found.left_rad_s > 0.5 * found.rate_rad_s


def test_the_fit_states_what_it_is_worth():
    A = np.stack((np.ones(200), np.linspace(0.0, 1.0, 200)), axis=1)
    tries = np.array([least_squares(A, A @ [1.0, 2.0] + 0.1 * e).x for e in noise(200, 200)])
    fit = least_squares(A, A @ [1.0, 2.0] + 0.1 * noise(200))
    assert fit.sigma == pytest.approx(tries.std(axis=0), rel=0.25)
    assert fit.rms == pytest.approx(0.1, rel=0.2)
    with pytest.raises(Unfit):
        least_squares(np.ones((5, 2)), np.ones(5))


def test_the_lowest_is_found_between_the_points_of_the_grid():
    assert lowest(lambda x: (x - 0.123) ** 2, np.linspace(0.0, 1.0, 11)) == pytest.approx(0.123)
    assert lowest(lambda x: x, np.linspace(0.0, 1.0, 11)) == 0.0
