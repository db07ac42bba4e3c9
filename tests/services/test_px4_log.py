"""The bridge's telemetry and the observer on what real PX4 said during a guided flight."""

import itertools
import struct
from collections import defaultdict

import numpy as np
import pytest

from schemas.vehicle import FlightMode
from services.config import load
from services.force_estimator import observer
from services.px4_bridge import preflight
from services.px4_bridge.preflight import Estimate, Found, Identity, Thrust, Wanted
from services.px4_bridge.telemetry import Telemetry
from tests.services import px4_log

CONFIG = load("px4-sitl")
REAL32 = 9


@pytest.fixture(scope="module")
def log():
    return list(px4_log.packets())


@pytest.fixture(scope="module")
def truth():
    return px4_log.truth()


@pytest.fixture(scope="module")
def heard(log):
    """The bridge's samples: the vehicle's by time, and every inertial one."""
    telemetry, vehicle, inertial = Telemetry(CONFIG.px4_bridge.vehicle), [], []
    for packet in log:
        telemetry.take(packet.name, packet.fields, 1000 * packet.t_us)
        inertial += telemetry.drain()
        if packet.name in ("LOCAL_POSITION_NED", "CURRENT_MODE", "HEARTBEAT", "EXTENDED_SYS_STATE"):
            vehicle.append((1e-6 * packet.t_us, telemetry.sample(1000 * packet.t_us)))
    assert telemetry.dropped == 0
    return vehicle, inertial


def changes(values):
    """Each value once, in order."""
    return [value for n, value in enumerate(values) if n == 0 or value != values[n - 1]]


def test_the_flight_is_seen_from_the_ground_to_the_ground(heard):
    vehicle, _ = heard
    assert changes([now.armed for _, now in vehicle]) == [False, True, False]
    assert changes([now.in_air for _, now in vehicle]) == [False, True, False]
    modes = changes([now.mode for _, now in vehicle])
    assert modes[-2:] == [FlightMode.OFFBOARD, FlightMode.LAND]
    assert all(now.connected for t, now in vehicle if t > vehicle[0][0] + 1.5)  # since the first heartbeat
    assert vehicle[-1][1].battery_fraction > 0.5


def test_px4s_position_is_the_true_one(heard, truth):
    vehicle, _ = heard
    flown = [(t, now.p_W) for t, now in vehicle if now.armed and now.has_position]
    t = np.array([t for t, _ in flown])
    p = np.array([p for _, p in flown])
    error = p - np.stack([np.interp(t, truth.t_s, truth.p_W[:, i]) for i in range(3)], axis=1)
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 0.03


def test_inertial_samples_come_at_250_hz_and_in_order(heard):
    _, inertial = heard
    stamps = np.array([sample.stamp_ns for sample in inertial]) * 1e-9
    assert len(stamps) / (stamps[-1] - stamps[0]) == pytest.approx(250.0, rel=0.03)
    assert np.all(np.diff(stamps) > 0.002)


def test_motor_outputs_are_microseconds_in_the_profiles_range(log):
    p = CONFIG.px4_bridge.vehicle
    outputs = np.array([packet.fields["actuator"][:4] for packet in log if packet.name == "ACTUATOR_OUTPUT_STATUS"])
    turning = outputs[np.all(outputs >= p.actuator_min, axis=1)]
    assert np.all(turning <= p.actuator_max)
    assert np.array_equal(turning, np.round(turning))
    assert len(turning) > 0.5 * len(outputs)


def test_the_heartbeat_is_slow_and_the_mode_is_told_at_once(log):
    """Why the bridge listens to CURRENT_MODE."""
    times = defaultdict(list)
    offboard = 6 << 16
    first: dict[str, int] = {}
    for packet in log:
        times[packet.name].append(1e-6 * packet.t_us)
        if packet.fields.get("custom_mode") == offboard:
            first.setdefault(packet.name, packet.t_us)
    assert np.median(np.diff(times["HEARTBEAT"])) == pytest.approx(1.0, abs=0.05)
    assert first["CURRENT_MODE"] <= first["HEARTBEAT"]


def test_the_observer_finds_the_cables_force(heard, truth):
    """Zeroed in hover as the estimator does it, then against the truth while the person is guided."""
    _, inertial = heard
    p, state = CONFIG.force_estimator.observer, observer.start()
    t, forces = [], []
    for before, sample in itertools.pairwise(inertial):
        dt = (sample.stamp_ns - before.stamp_ns) * 1e-9
        state, f_c = observer.step(state, sample.specific_force_B, sample.q_WB_wxyz, sample.thrust_N, dt, p)
        t.append(sample.stamp_ns * 1e-9)
        forces.append(f_c)
    t, forces = np.array(t), np.array(forces)
    f_c = np.stack([np.interp(t, truth.t_s, truth.f_c_W[:, i]) for i in range(3)], axis=1)
    phase = truth.phase[np.clip(np.searchsorted(truth.t_s, t), 0, len(truth.t_s) - 1)]
    bias = np.mean((forces - f_c)[phase == "zeroing"], axis=0)
    assert np.linalg.norm(bias) < 0.1
    error = (forces - bias - f_c)[phase == "guiding"]
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 0.08


def test_the_preflight_finds_nothing_against_the_flight_that_was_flown(log, heard):
    told = {packet.fields["param_id"]: parameter(packet.fields) for packet in log if packet.name == "PARAM_VALUE"}
    (beat, *_) = (packet.fields for packet in log if packet.name == "HEARTBEAT")
    vehicle, inertial = heard
    resting = [s for s in inertial if s.stamp_ns < 1e9 * next(t for t, now in vehicle if now.armed)]
    found = Found(
        identity=Identity(beat["autopilot"], beat["type"], (1, 17, 0)),  # the log has no version, no estimator's word
        parameters=told,
        refused=(),
        armed=False,
        specific_force_mps2=float(np.mean([np.linalg.norm(s.specific_force_B) for s in resting])),
        poses=1,
        estimate=Estimate(True, 0.0, 0.0),
        arming=(),
        battery_fraction=vehicle[-1][1].battery_fraction,
        pilot=False,
    )
    p = CONFIG.px4_bridge.vehicle
    as_flown = CONFIG.px4_bridge.px4 | {"EKF2_BARO_CTRL": 0}  # wanted only since the log was kept
    del as_flown["COM_KILL_DISARM"]  # the same
    wanted = Wanted(as_flown, Thrust(p.thrust_source, p.thrust_error, True, False), 0.8, 1.5, 0.3)
    assert preflight.reasons(found, wanted) == []
    told["COM_OBL_RC_ACT"] = 0
    assert len(preflight.reasons(found, wanted)) == 1


def parameter(fields):
    """Integers travel as the bits of a float."""
    value = fields["param_value"]
    return value if fields["param_type"] == REAL32 else struct.unpack("<i", struct.pack("<f", value))[0]
