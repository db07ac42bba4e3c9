"""`clew calibrate` on a flight of which the truth is known: the stand-in's, as it was recorded."""

import pytest

from schemas.topics import PARAMETERS
from services.config import load
from services.console.calibrate import Asked, calibrate


@pytest.fixture
def asked(flown, tmp_path):
    """The words of a command on the recorded flight."""
    return lambda kind, **words: Asked(
        kind=kind, profile="demo", recordings=[flown[1]], out=tmp_path / "lab.toml", **words
    )


@pytest.fixture
def laid_over(tmp_path):
    """The configuration with what was written."""

    def read():
        file = tmp_path / "mine.toml"
        file.write_text(f'base = "demo"\n[system]\ncalibration = "{tmp_path / "lab.toml"}"\n')
        return load(str(file))

    return read


def thrust_N(config, share):
    p = config.px4_bridge.vehicle
    return p.max_thrust_N * ((1.0 - p.thrust_curve) * share + p.thrust_curve * share**2)


def test_thrust_and_mass_of_the_stand_in_are_found_in_an_ordinary_flight(asked, laid_over, capsys):
    assert calibrate(asked("thrust")) == 0
    assert calibrate(asked("mass")) == 0
    assert "left: " in capsys.readouterr().out
    truth, found = load("demo"), laid_over()
    for share in (0.48, 0.52, 0.56):
        assert thrust_N(found, share) == pytest.approx(thrust_N(truth, share), rel=0.01)
    assert found.px4_bridge.vehicle.thrust_error < 0.02
    assert found.force_estimator.observer.m_R_kg == pytest.approx(truth.vehicle.quadrotor.mass_kg, rel=0.01)
    assert found.calibration.thrust is not None
    assert found.calibration.thrust.found.recording.endswith("session.mcap")


def test_thrust_goes_with_the_mass_that_is_believed(asked, laid_over):
    heavier = 1.05 * load("demo").vehicle.quadrotor.mass_kg
    assert calibrate(asked("thrust", mass_kg=heavier)) == 0
    assert thrust_N(laid_over(), 0.52) == pytest.approx(1.05 * thrust_N(load("demo"), 0.52), rel=0.01)


def test_a_whole_flight_shows_that_its_poses_are_not_late(asked, laid_over):
    assert calibrate(asked("delay")) == 0
    assert 0.0 <= laid_over().px4_bridge.px4["EKF2_EV_DELAY"] < 3.0


def test_what_a_flight_does_not_show_is_refused_and_nothing_is_written(asked, tmp_path, capsys):
    assert calibrate(asked("handle")) == 1
    assert "clew calibrate handle: the handle turned too little" in capsys.readouterr().err
    assert not (tmp_path / "lab.toml").exists()


def test_a_recording_that_is_not_there_is_bad_input(asked, tmp_path, capsys):
    nowhere = Asked(kind="thrust", profile="demo", recordings=[tmp_path / "nowhere.mcap"], out=tmp_path / "lab.toml")
    assert calibrate(nowhere) == 2
    assert "nowhere.mcap" in capsys.readouterr().err


def test_the_autopilots_parameters_are_in_the_recording(recorded):
    (said,) = recorded.messages(PARAMETERS)
    assert said.integers["COM_OBL_RC_ACT"] == 4
    assert said.reals["COM_OF_LOSS_T"] == 0.5
