"""What stands against a flight on the side of motion capture and of the clocks."""

import numpy as np
import pytest

from schemas.radio import RadioClock
from services.config import load
from services.console.preflight_ground import clock_reasons
from services.tracker.preflight import CHECKS, Frames, reasons

CONFIG = load("ground")
P, SYSTEM = CONFIG.tracker, CONFIG.tracker.mocap
assert SYSTEM
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
N = 400


def frames(**changes: object) -> Frames:
    """Four seconds at 100 Hz, both bodies on the floor, as they should be; with changes."""
    lying = np.array([[-2.0, -0.5, 0.08], [-2.0, -0.9, 0.02]])
    good = Frames(
        lasted_s=N / 100,
        stamp_s=np.arange(N) / 100,
        late_s=np.full(N, 0.002),
        robot=np.ones(N, dtype=bool),
        handle=np.ones(N, dtype=bool),
        position_m=lying + np.random.default_rng(2).normal(0.0, 1e-4, (N, 2, 3)),
        q_WB_wxyz=np.tile(LEVEL, (N, 1)),
        trouble="",
    )
    return good._replace(**changes)


def told(**changes: object) -> list[str]:
    assert SYSTEM
    return [what for what, _ in reasons(frames(**changes), SYSTEM, P.axes)]


def test_a_capture_system_as_it_should_be_stands_against_nothing():
    assert told() == []


def test_without_frames_the_clients_complaint_is_the_one_reason():
    none = {"stamp_s": np.zeros(0), "late_s": np.zeros(0), "robot": np.zeros(0, bool), "handle": np.zeros(0, bool)}
    empty = none | {"position_m": np.zeros((0, 2, 3)), "q_WB_wxyz": np.zeros((0, 4)), "lasted_s": 0.0}
    assert told(**empty, trouble="no frame from vicon at 192.168.10.1 for 3 s") == [
        "no frame from vicon at 192.168.10.1 for 3 s"
    ]


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        (
            {"trouble": "no body handel in vicon; it has: handle, robot"},
            "no body handel in vicon; it has: handle, robot",
        ),
        ({"handle": np.arange(N) % 20 > 0}, "handle is seen in 95.0% of the frames"),
        ({"lasted_s": 10.0}, "40 frames a second, the profile wants 50 to 250 Hz"),
        ({"lasted_s": 1.0}, "400 frames a second, the profile wants 50 to 250 Hz"),
        ({"stamp_s": np.arange(N) / 100 + 0.2 * (np.arange(N) > 200)}, "0.21 s without a frame"),
        ({"late_s": np.where(np.arange(N) % 50, 0.002, 0.03)}, "one frame in a hundred arrives 30 ms late"),
        ({"position_m": frames().position_m[..., [0, 2, 1]] * [1, 1, -1]}, "the capture system's y axis is up"),
        ({"position_m": frames().position_m + [0.0, 0.0, 1.0]}, "robot and handle do not lie still on the floor"),
    ],
)
def test_each_fault_is_the_one_reason(changes, what):
    (found,) = told(**changes)
    assert found.startswith(what)


def test_the_connection_comes_before_the_axes():
    assert [check.name for check in CHECKS][:2] == ["connection", "bodies"]
    assert CHECKS[-1].name == "axes"


def clock(**changes: object) -> RadioClock:
    good = RadioClock(
        ground_minus_drone_ns=5,
        uncertainty_s=0.01,
        round_trip_s=0.01,
        time_of_day_apart_s=0.1,
        up=True,
        connects=1,
        unanswered=0,
    )
    return good.model_copy(update=changes)


@pytest.mark.parametrize(
    ("found", "what"),
    [
        (None, "the clocks of the two hosts are not compared"),
        (clock(uncertainty_s=0.08), "the hosts' clocks are known to 80 ms, at most 50 ms to begin"),
        (clock(time_of_day_apart_s=-3.0), "the hosts differ by 3.0 s in the time of day"),
    ],
)
def test_clocks_that_the_supervisor_would_not_start_with(found, what):
    ((said, _),) = clock_reasons(found, CONFIG.safety_supervisor.limits)
    assert said == what
    assert clock_reasons(clock(), CONFIG.safety_supervisor.limits) == []
