"""What really breaks processes, on the real system in real time: `make test-faults`.

Times are those of the promises and a second for the host, which is no real-time machine and runs the simulated world as well.
"""

import multiprocessing
import resource
import signal
import time

import pytest

from schemas.safety import Phase
from schemas.topics import HEALTH, SAFETY_STATE, SETPOINT, TRUTH
from tests.processes.flown import Flown, fly

pytestmark = [pytest.mark.faults, pytest.mark.timeout(150)]
HOST_S = 1.0
ON_THE_BUS = ("tracker", "force_estimator", "guiding_controller", "safety_supervisor")


@pytest.fixture(autouse=True)
def _own_run_dir(tmp_path, monkeypatch):
    monkeypatch.setenv("CLEW_RUN_DIR", str(tmp_path / "run"))


def assert_no_pull(flown: Flown, until_s: float = float("inf")) -> None:
    assert flown.pull_N(-0.5, 0.1) > 0.5, "nothing was pulling"
    assert flown.eased_after_s() < 0.3 + HOST_S
    assert flown.pull_N(0.8 + HOST_S, until_s) < 0.3
    assert flown.commanded_N() <= 2.5


@pytest.mark.parametrize("name", ON_THE_BUS)
def test_killed(tmp_path, name):
    until_s = 3.0 if name == "safety_supervisor" else 4.0  # then the bridge lands
    assert_no_pull(fly(tmp_path, lambda flown: flown.signal(name, signal.SIGKILL), 4.0), until_s)


def test_bridge_killed(tmp_path):
    flown = fly(tmp_path, lambda flown: flown.signal("px4_bridge", signal.SIGKILL), 12.0)
    assert flown.silent_after_s() < 0.1
    assert flown.heard[SAFETY_STATE.key][-1].phase in (Phase.LANDING, Phase.LANDED)
    assert flown.heard[TRUTH.key][-1].robot_position_m.z < 0.15


@pytest.mark.parametrize("seconds", [0.3, 1.0, 5.0])
@pytest.mark.parametrize("name", ["force_estimator", "safety_supervisor"])
def test_stopped_and_continued(tmp_path, name, seconds):
    def act(flown: Flown) -> None:
        flown.signal(name, signal.SIGSTOP)
        flown.later(seconds, lambda: flown.signal(name, signal.SIGCONT))

    flown = fly(tmp_path, act, seconds + 2.0)
    assert flown.eased_after_s() < 0.3 + HOST_S
    assert flown.commanded_N() <= 2.5


def test_bridge_stopped_leaves_no_old_set_point_behind(tmp_path):
    def act(flown: Flown) -> None:
        flown.signal("px4_bridge", signal.SIGSTOP)
        flown.later(1.5, lambda: flown.signal("px4_bridge", signal.SIGCONT))

    flown = fly(tmp_path, act, 5.0)
    assert not [m for m in flown.after(SETPOINT.key) if 0.1 < m.stamp_ns * 1e-9 - flown.broken_s < 1.4]
    assert flown.commanded_N() <= 2.5
    assert flown.heard[SAFETY_STATE.key][-1].phase in (Phase.LANDING, Phase.LANDED)


@pytest.mark.parametrize("name", ["guiding_controller", "safety_supervisor"])
def test_restarted(tmp_path, name):
    def act(flown: Flown) -> None:
        flown.signal(name, signal.SIGKILL)
        flown.later(0.5, lambda: flown.start_again(name))

    flown = fly(tmp_path, act, 8.0)
    assert flown.eased_after_s() < 0.3 + HOST_S
    assert flown.commanded_N() <= 2.5
    phase = flown.heard[SAFETY_STATE.key][-1].phase
    assert phase in ((Phase.HOLD, Phase.LANDING) if name == "safety_supervisor" else (Phase.GUIDING, Phase.ARRIVED))


def _spin(until: float) -> None:
    while time.monotonic() < until:
        pass


def test_processor_starved(tmp_path):
    """Two busy loops on each processor: it may ease or not; it may not pull harder than it did."""

    def act(flown: Flown) -> None:
        for _ in range(2 * multiprocessing.cpu_count()):
            multiprocessing.Process(target=_spin, args=(time.monotonic() + 3.0,), daemon=True).start()

    flown = fly(tmp_path, act, 5.0)
    assert flown.commanded_N() <= 2.5
    assert flown.heard[SAFETY_STATE.key][-1].phase in (Phase.GUIDING, Phase.ARRIVED, Phase.LANDING, Phase.HOLD)


def test_disk_full(tmp_path):
    """The recorder cannot write any more: it says so, and the flight goes on."""

    def act(flown: Flown) -> None:
        full = (tmp_path / "session.mcap").stat().st_size  # of which no file may be larger
        resource.prlimit(flown.pid("recorder"), resource.RLIMIT_FSIZE, (full, full))

    flown = fly(tmp_path, act, 4.0)
    assert "STOPPED: the file cannot be written" in flown.heard[HEALTH["recorder"].key][-1].status
    assert flown.heard[SAFETY_STATE.key][-1].phase is Phase.GUIDING
    assert flown.pull_N(3.0) > 0.5
