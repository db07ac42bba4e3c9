"""A calibration's file: written, read back, laid over a profile; and what is wrong with it told in one line."""

import pytest

from schemas.vehicle import ThrustSource
from services.calibration import result
from services.calibration.layer import calibration_file
from services.calibration.result import DelayResult, Found, HandleResult, MassResult, ThrustResult
from services.config import ConfigError, load

FOUND = Found(
    date="2026-01-02T03:04:05+00:00",
    recording='a "quoted" \\ name',
    recorded_by="0.1.0",
    found_by="0.1.0 abc",
    seconds=12.5,
    residual=0.004,
    residual_max=0.02,
    residual_unit="of the thrust",
    condition=57.0,
)
THRUST = ThrustResult(
    thrust_source=ThrustSource.ACTUATOR_OUTPUTS,
    max_thrust_N=17.25,
    thrust_curve=0.3,
    thrust_error=0.004,
    voltage_exponent=1.5,
    reference_V=11.1,
    rpm_max=1.0,
    lag_s=0.05,
    low_N=7.0,
    high_N=9.0,
    found=FOUND,
)


@pytest.fixture
def profile(tmp_path):
    """A profile, and the calibration that it names."""
    lab = tmp_path / "lab.toml"
    file = tmp_path / "mine.toml"
    file.write_text(f'base = "demo"\n[system]\ncalibration = "{lab}"\n')
    return str(file), lab


def test_what_was_measured_is_what_flies(profile):
    file, lab = profile
    result.write(lab, THRUST)
    result.write(lab, MassResult(m_R_kg=0.83, sigma_kg=0.001, thrust_scale=1.0, found=FOUND))
    result.write(lab, HandleResult(offset_m=(0.01, 0.0, -0.04), found=FOUND))
    result.write(lab, DelayResult(delay_s=0.0125, sigma_s=0.001, found=FOUND))
    config = load(file)
    vehicle = config.px4_bridge.vehicle
    assert (vehicle.max_thrust_N, vehicle.thrust_curve, vehicle.thrust_error) == (17.25, 0.3, 0.004)
    assert (vehicle.voltage_exponent, vehicle.reference_V) == (1.5, 11.1)
    assert config.px4_bridge.flight.m_R_kg == config.force_estimator.observer.m_R_kg == 0.83
    assert config.px4_bridge.admittance.M_A_kg == 0.83
    assert config.vehicle.quadrotor.mass_kg == 0.8, "the simulated vehicle is what it is"
    assert config.px4_bridge.px4["EKF2_EV_DELAY"] == pytest.approx(12.5)
    assert config.calibration.thrust == THRUST


def test_one_kind_is_renewed_and_the_others_stay(profile):
    file, lab = profile
    result.write(lab, THRUST)
    result.write(lab, HandleResult(offset_m=(0.01, 0.0, -0.04), found=FOUND))
    result.write(lab, HandleResult(offset_m=(0.02, 0.0, -0.04), found=FOUND))
    calibration = load(file).calibration
    assert calibration.thrust == THRUST
    assert calibration.handle is not None
    assert calibration.handle.offset_m == (0.02, 0.0, -0.04)


def test_a_profile_without_one_flies_as_it_says():
    assert load("demo").calibration == result.Calibration()
    assert calibration_file("demo") is None


def test_where_it_will_be_written_is_known_before_it_is_there(profile):
    file, lab = profile
    assert calibration_file(file) == lab
    with pytest.raises(ConfigError, match="no such file"):
        load(file)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("17.25", "-1.0"), "lab.toml: thrust.max_thrust_N = -1.0: must be greater than 0"),
        (('"actuator_outputs"', '"esc_rpm"'), "lab.toml: thrust.thrust_source = esc_rpm: must be the profile's"),
        (("lag_s", "lag"), "lab.toml: thrust.lag_s: is missing"),
    ],
)
def test_a_fault_in_it_is_told_with_its_file_and_key(profile, change, told):
    file, lab = profile
    result.write(lab, THRUST)
    lab.write_text(lab.read_text().replace(*change))
    with pytest.raises(ConfigError) as error:
        load(file)
    assert told in str(error.value).splitlines()[0]
