"""`clew calibrate handle` and `delay` on recordings of the whole system, with vehicle and handle turned by hand."""

import numpy as np
import pytest

from schemas.topics import HANDLE_STATE
from services.config import load
from services.console.calibrate import Asked, calibrate
from services.recorder.reading import read
from tests.services.by_hand import O_H, held

pytestmark = pytest.mark.slow

OFFSET_M = np.array([0.021, -0.013, 0.087])
BELIEVED_M = np.array([0.0, 0.02, 0.05])
LATE_S = 0.044
PROFILE = """base = "demo"
[system]
calibration = "{lab}"
[tracker]
source = "qualisys"
[tracker.mocap]
host = "127.0.0.1"
rate_min_Hz = 50.0
rate_max_Hz = 250.0
repeat_s = 0.3
restart_s = 3.0
robot = {{ body = "robot" }}
handle = {{ body = "handle", offset_m = {believed} }}
"""


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    """A profile that knows neither offset nor delay, and the recording that was made with it."""
    folder = tmp_path_factory.mktemp("laboratory")
    profile, lab = folder / "mine.toml", folder / "lab.toml"
    lab.touch()
    profile.write_text(PROFILE.format(lab=lab, believed=BELIEVED_M.tolist()))
    recording = folder / "session.mcap"
    held(load(str(profile)), OFFSET_M, LATE_S, 15.0, recording)
    return profile, recording, lab


def test_what_the_simulation_was_given_is_found_and_goes_where_it_belongs(laboratory, tmp_path):
    profile, recording, lab = laboratory
    seen = read(recording).table(HANDLE_STATE)["position_m"][100:]
    assert np.max(np.linalg.norm(seen - O_H, axis=1)) > 0.02, "the wrong offset shows nothing"
    for kind in ("handle", "delay"):
        assert calibrate(Asked(kind=kind, profile=str(profile), recordings=[recording])) == 0
    assert sorted(line for line in lab.read_text().splitlines() if line.startswith("[")) == [
        "[delay.found]",
        "[delay]",
        "[handle.found]",
        "[handle]",
    ]
    found = load(str(profile))
    assert found.tracker.mocap is not None
    assert found.tracker.mocap.handle.offset_m == pytest.approx(OFFSET_M, abs=2e-4)
    assert found.px4_bridge.px4["EKF2_EV_DELAY"] == pytest.approx(1000.0 * LATE_S, abs=1.0)
    again = held(found, OFFSET_M, LATE_S, 5.0, tmp_path / "again.mcap")
    after = np.array([m.position_m.array() for m in again.said[HANDLE_STATE.key]])[100:]
    assert len(after) > 100
    assert np.max(np.linalg.norm(after - O_H, axis=1)) < 2e-3
