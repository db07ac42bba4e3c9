"""The stand-in autopilot does what was measured on real PX4: refusals, failsafes, landings, estimates."""

from copy import copy
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.physics import Array
from services.simulator import autopilot, estimator
from services.simulator.autopilot import STEP_S
from services.simulator.commander import Ack, Arm, KillSwitch, Mode, SetOrigin, SetParameter, Switch, Terminate
from services.simulator.estimator import EstimatorState
from tests.laws.standin import ABOVE, Standin, at, parameters

TOLERANCE = 0.3  # of every measured time


@cache
def hovering() -> Standin:
    drone = Standin()
    drone.take_off()
    return drone


def flying(**px4: float) -> Standin:
    """A copy of one that hovers in offboard, with other parameters."""
    drone = copy(hovering())
    drone.state = drone.state._replace(px4={**drone.state.px4, **px4})
    drone.texts = []
    assert drone.mode is Mode.OFFBOARD
    assert drone.armed
    return drone


def test_offboard_without_a_stream_is_accepted_on_the_ground_but_does_not_arm():
    drone = Standin()
    drone.run(1.0)
    assert drone.ask(Switch(Mode.OFFBOARD)) is Ack.ACCEPTED
    assert drone.ask(Arm(True)) is Ack.DENIED
    drone.run(1.0)
    assert not drone.armed
    assert drone.robot.p_W[2] == pytest.approx(drone.body.gear_height_m)


def test_it_does_not_arm_without_a_position():
    drone = Standin()
    drone.mocap_offset_W, drone.target = None, at(ABOVE)
    drone.run(1.0)
    assert drone.ask(Switch(Mode.OFFBOARD)) is Ack.ACCEPTED
    assert drone.ask(Arm(True)) is Ack.DENIED


def test_it_flies_to_its_set_point():
    drone = flying()
    assert np.linalg.norm(drone.robot.p_W - ABOVE) < 0.03
    assert not drone.state.ground.landed


def test_armed_and_left_on_the_ground_it_disarms():
    drone = Standin(parameters(COM_DISARM_PRFLT=3.0))
    drone.run(0.5)
    drone.ask(SetOrigin())
    assert drone.ask(Arm(True)) is Ack.ACCEPTED
    assert drone.run(10.0, lambda: not drone.armed) == pytest.approx(3.0, rel=0.05)


@pytest.mark.parametrize(("loss_s", "earliest_s", "latest_s"), [(0.5, 0.73, 0.89), (1.0, 1.3, 1.7)])
def test_offboard_is_left_when_the_stream_stops(loss_s: float, earliest_s: float, latest_s: float):
    drone = flying(COM_OF_LOSS_T=loss_s)
    drone.target = None
    left_s = drone.run(5.0, lambda: drone.mode is not Mode.OFFBOARD)
    assert (1 - TOLERANCE) * earliest_s < left_s < (1 + TOLERANCE) * latest_s
    assert drone.mode is Mode.LAND
    assert any("Failsafe" in text for text in drone.texts)


def test_a_gap_shorter_than_the_limit_passes():
    drone = flying()
    target, drone.target = drone.target, None
    drone.run(0.45)
    drone.target = target
    drone.run(1.0)
    assert drone.mode is Mode.OFFBOARD


def test_landing_after_offboard_loss_disarms_and_wants_a_new_arm():
    drone = flying()
    drone.target = None
    assert drone.run(20.0, lambda: not drone.armed) < 20.0
    assert drone.robot.p_W[2] == pytest.approx(drone.body.gear_height_m)
    drone.target = at(ABOVE)
    drone.run(3.0)
    assert not drone.armed
    assert drone.mode is Mode.OFFBOARD  # as it was asked for, and as PX4 shows it
    assert drone.ask(Arm(True)) is Ack.ACCEPTED


def test_landing_goes_on_when_the_stream_is_back():
    drone = flying()
    drone.target = None
    drone.run(1.2)
    drone.target = at(ABOVE)
    drone.run(1.0)
    assert drone.mode is Mode.LAND
    assert drone.ask(Switch(Mode.OFFBOARD)) is Ack.ACCEPTED
    assert drone.mode is Mode.OFFBOARD


def test_action_0_sinks_stays_armed_and_climbs_again_by_itself():
    drone = flying(COM_OBL_RC_ACT=0)
    drone.target = None
    drone.run(8.0)
    assert drone.robot.p_W[2] == pytest.approx(drone.body.gear_height_m)
    assert drone.armed
    assert drone.mode is Mode.DESCEND
    drone.target = at(ABOVE)
    assert drone.run(5.0, lambda: drone.mode is Mode.OFFBOARD) < (1 + TOLERANCE) * 0.25
    drone.run(4.0)
    assert drone.robot.p_W[2] > 0.8


def test_action_hold_stays_and_goes_on_by_itself():
    drone = flying(COM_OBL_RC_ACT=5)
    assert drone.ask(SetOrigin()) is Ack.ACCEPTED
    drone.target = None
    drone.run(8.0)
    assert drone.mode is Mode.HOLD
    assert np.linalg.norm(drone.robot.p_W - ABOVE) < 0.05
    drone.target = at(ABOVE)
    assert drone.run(5.0, lambda: drone.mode is Mode.OFFBOARD) < (1 + TOLERANCE) * 0.25


def test_hold_without_an_origin_is_refused_and_as_an_action_becomes_land():
    drone = flying(COM_OBL_RC_ACT=5)
    assert drone.ask(Switch(Mode.HOLD)) is Ack.TEMPORARILY_REJECTED
    drone.target = None
    drone.run(2.0)
    assert drone.mode is Mode.LAND


def test_land_on_demand_lands_where_it_is_and_disarms():
    drone = flying()
    assert drone.ask(Switch(Mode.LAND)) is Ack.ACCEPTED
    assert drone.run(20.0, lambda: not drone.armed) < 20.0
    assert np.linalg.norm(drone.robot.p_W[:2]) < 0.05
    assert "Disarmed by landing" in drone.texts


def test_disarming_in_the_air_is_refused_terminating_is_not():
    drone = flying()
    assert drone.ask(Arm(False)) is Ack.DENIED
    assert drone.armed
    assert drone.ask(Terminate()) is Ack.ACCEPTED
    drone.run(1.0)
    assert drone.robot.p_W[2] == pytest.approx(drone.body.gear_height_m)


def test_a_pilots_kill_switch_disarms_at_once_and_keeps_it_from_arming():
    drone = flying()
    drone.ask(KillSwitch(True))
    assert not drone.armed
    assert not drone.state.motors.any()
    drone.run(1.0)
    assert drone.robot.p_W[2] == pytest.approx(drone.body.gear_height_m)
    assert drone.ask(Arm(True)) is Ack.DENIED
    drone.ask(KillSwitch(False))
    assert not drone.armed
    assert drone.ask(Arm(True)) is Ack.ACCEPTED


def test_where_it_disarms_later_the_switchs_way_back_starts_the_motors_again():
    drone = flying(COM_KILL_DISARM=1.5)
    drone.ask(KillSwitch(True))
    drone.run(1.4)
    assert drone.armed
    assert not drone.state.motors.any()
    drone.ask(KillSwitch(False))
    assert drone.state.motors.all()
    drone.ask(KillSwitch(True))
    assert drone.run(10.0, lambda: not drone.armed) == pytest.approx(1.5, abs=0.01)


def test_an_autopilot_that_takes_no_remote_control_does_not_hear_the_switch():
    drone = flying(COM_RC_IN_MODE=4)
    drone.ask(KillSwitch(True))
    drone.run(1.0)
    assert drone.armed
    assert np.linalg.norm(drone.robot.p_W - ABOVE) < 0.03


def test_two_seconds_without_motion_capture_pass_unnoticed():
    drone = flying()
    drone.mocap_offset_W = None
    drone.run(2.0)
    drone.mocap_offset_W = np.zeros(3)
    drone.run(1.0)
    assert drone.mode is Mode.OFFBOARD
    assert np.linalg.norm(drone.robot.p_W - ABOVE) < 0.1


def test_without_motion_capture_it_reckons_for_a_while_then_descends():
    drone = flying()
    drone.mocap_offset_W = None
    assert drone.run(10.0, lambda: drone.mode is Mode.DESCEND) == pytest.approx(4.7, rel=TOLERANCE)
    assert drone.run(20.0, lambda: not drone.armed) < 20.0
    assert drone.robot.p_W[2] == pytest.approx(drone.body.gear_height_m)


def test_a_jump_of_motion_capture_is_refused_then_chased():
    drone = flying()
    drone.mocap_offset_W = np.array([0.5, 0.0, 0.0])
    before = drone.state.estimator.resets
    reset_s = drone.run(5.0, lambda: drone.state.estimator.resets > before)
    assert reset_s == pytest.approx(1.5, rel=TOLERANCE)
    assert np.linalg.norm(drone.robot.p_W - ABOVE) < 0.05
    drone.run(8.0)
    assert np.linalg.norm(drone.robot.p_W - (ABOVE - drone.mocap_offset_W)) < 0.05


def estimated(v: Array, delay_steps: int, start: float, *, told: bool) -> EstimatorState:
    """After 4 s at constant speed with a perfect accelerometer and late poses, whose age is told or not."""
    p = parameters().estimator
    state = estimator.initial(np.zeros(3))._replace(since_accepted_s=0.0, p_W=np.array([start, 0.0, 0.0]))
    level, force = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 9.80665])
    for n in range(1, 1001):
        state = estimator.propagate(state, force, level, STEP_S, resting=False)
        if n % 4 == 0:
            age_s = delay_steps * STEP_S if told else 0.0
            state = estimator.correct(state, v * (n - delay_steps) * STEP_S, p, age_s)
    return state


@settings(max_examples=30, deadline=None)
@given(speed=st.floats(-1.0, 1.0), delay_steps=st.integers(0, 10), start=st.floats(-0.15, 0.15))
def test_the_estimate_is_late_by_a_delay_that_is_not_told(speed: float, delay_steps: int, start: float):
    """It settles at p(t - d)."""
    v = np.array([speed, 0.0, 0.0])
    state = estimated(v, delay_steps, start, told=False)
    np.testing.assert_allclose(state.v_W, v, atol=1e-6)
    np.testing.assert_allclose(state.p_W, v * (1000 - delay_steps) * STEP_S, atol=1e-6)


def astray_m(**px4: float) -> float:
    """Largest error of the estimate on the way to a place beside, with poses 60 ms late that do not say so."""
    drone, errors = flying(**px4), list[float]()
    drone.mocap_late_steps, drone.target = 15, at(ABOVE + [0.5, 0.0, 0.0])

    def over() -> bool:
        errors.append(float(np.linalg.norm(drone.state.estimate.p_W - drone.robot.p_W)))
        return False

    drone.run(3.0, over)
    return max(errors)


def test_ekf2_ev_delay_is_how_late_poses_are():
    untold = astray_m()
    assert untold > 0.02, "the delay does no harm: nothing is shown"
    assert astray_m(EKF2_EV_DELAY=60.0) < 0.3 * untold


@settings(max_examples=30, deadline=None)
@given(speed=st.floats(-1.0, 1.0), delay_steps=st.integers(0, 50), start=st.floats(-0.15, 0.15))
def test_a_delay_that_is_told_does_no_harm(speed: float, delay_steps: int, start: float):
    """It settles as quickly as without one, at p(t)."""
    v = np.array([speed, 0.0, 0.0])
    state = estimated(v, delay_steps, start, told=True)
    np.testing.assert_allclose(state.v_W, v, atol=1e-6)
    np.testing.assert_allclose(state.p_W, v * 1000 * STEP_S, atol=1e-6)


def test_a_pose_that_is_too_old_is_refused():
    p = parameters().estimator
    state = estimator.initial(np.zeros(3))._replace(since_accepted_s=0.0)
    assert estimator.correct(state, np.array([0.1, 0.0, 0.0]), p, p.delay_max_s + 0.001) is state


def test_parameters_keep_their_type_and_unknown_ones_are_refused():
    drone = Standin()
    assert drone.ask(SetParameter("COM_OBL_RC_ACT", 5.0)) is Ack.ACCEPTED
    assert drone.state.px4["COM_OBL_RC_ACT"] == 5
    assert isinstance(drone.state.px4["COM_OBL_RC_ACT"], int)
    assert drone.ask(SetParameter("NO_SUCH", 1.0)) is Ack.DENIED
    assert "NO_SUCH" not in drone.state.px4


def test_decoupling_is_the_cascades_own_parameter():
    drone = Standin()
    assert not drone.state.cascade.acc_decouple
    drone.ask(SetParameter("MPC_ACC_DECOUPLE", 1))
    assert drone.state.cascade.acc_decouple


def test_a_missing_parameter_is_named():
    p = parameters()
    del p.px4["COM_OF_LOSS_T"]
    with pytest.raises(ValueError, match=r"autopilot.px4: COM_OF_LOSS_T missing"):
        autopilot.initial(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), p)
