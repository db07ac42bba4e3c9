"""The last zeroing of a vehicle, read in its recordings, against the next flight."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from services.config import load
from services.console.preflight_tare import last_zeroing, look_at_tare
from services.force_estimator.preflight import Zeroing, reasons
from services.physics import norm

CONFIG = load("demo")
P = CONFIG.force_estimator.bias


@pytest.fixture
def sessions(flown, tmp_path):
    """A folder with the recorded flight in it, behind an older one that was never finished and a link to the newest."""
    for name in ("2026-01-01T10-00-00", "2026-01-02T10-00-00"):
        (tmp_path / name).mkdir()
    (tmp_path / "2026-01-01T10-00-00" / "session.mcap").write_bytes(b"cut")
    shutil.copy(flown[1], tmp_path / "2026-01-02T10-00-00" / "session.mcap")
    (tmp_path / "latest").symlink_to("2026-01-02T10-00-00")
    return tmp_path


def test_the_bias_that_was_taken_in_the_last_flight_is_read_back(flown, sessions):
    found = last_zeroing(CONFIG, sessions)
    assert found is not None
    assert found.session == "2026-01-02T10-00-00"
    taken = flown[0].said["force/cable"][-1]
    change = taken.bias_change_N
    assert norm(found.bias_N - taken.bias_N.array()) < change + 0.01
    assert look_at_tare(CONFIG, sessions) == []


def test_a_vehicle_that_is_believed_to_be_another_one_has_no_zeroing_yet(sessions):
    heavier = replace(CONFIG.force_estimator.bias, handle_weight_N=0.4)
    estimator = replace(CONFIG.force_estimator, bias=heavier)
    assert last_zeroing(CONFIG.model_copy(update={"force_estimator": estimator}), sessions) is None


def test_a_host_that_records_nothing_knows_nothing(sessions):
    strict = replace(CONFIG.force_estimator, bias=replace(P, tare_bias_max_N=1e-6))
    system = replace(CONFIG.system, services=("tracker",))
    here = CONFIG.model_copy(update={"force_estimator": strict})
    assert len(look_at_tare(here, sessions)) == 1
    assert look_at_tare(here.model_copy(update={"system": system}), sessions) == []


@pytest.mark.parametrize(("bias_N", "told"), [(0.74, False), (0.76, True), (2.0, True)])
def test_more_than_half_of_what_zeroing_takes_is_told_with_its_session(bias_N, told):
    listed = reasons(Zeroing("2026-01-02T10-00-00", bias_N * np.array([0.6, 0.0, 0.8])), P)
    assert bool(listed) == told
    for what, cure in listed:
        assert what.startswith(f"the last zeroing (2026-01-02T10-00-00) found {bias_N:.2f} N of bias: at most 0.75 N")
        assert "clew calibrate thrust" in cure


def test_before_the_first_zeroing_nothing_is_known(tmp_path):
    assert last_zeroing(CONFIG, tmp_path) is None
    assert reasons(None, P) == []
