"""What PX4 is told about the simulated vehicle, held against the vehicle itself."""

import numpy as np
import pytest

from services.config import load
from services.physics import GRAVITY_MPS2
from services.simulator import px4_sitl, quadrotor
from services.simulator.quadrotor import at_rest

VEHICLE = load("px4-sitl").vehicle
BODY = VEHICLE.quadrotor
TOLD = px4_sitl.of_vehicle(BODY, VEHICLE.cascade)
HIGH = np.array([0.0, 0.0, 2.0])


@pytest.mark.parametrize("n", range(4))
def test_each_motor_turns_the_body_the_way_px4_is_told(n):
    """PX4's effectiveness of a rotor (forward, right, down): force -z at (PX, PY), and a moment of KM about down."""
    stronger = np.full(4, 0.3)
    stronger[n] = 0.6
    turned = quadrotor.step(at_rest(HIGH, BODY), stronger, np.zeros(3), 0.001, BODY).omega_B
    x, y, km = (float(TOLD[f"CA_ROTOR{n}_{what}"]) for what in ("PX", "PY", "KM"))
    roll, pitch, yaw = -y, x, km  # about forward, right, down: r x (0, 0, -1), and the reaction of the rotor
    told_B = np.array([roll, -pitch, -yaw])  # forward, left, up
    assert np.array_equal(np.sign(turned), np.sign(told_B))
    lever = np.hypot(x, y)
    assert lever == pytest.approx(BODY.arm_length_m, rel=1e-4)


def test_the_hover_thrust_that_px4_is_told_carries_the_vehicle():
    lift = 4.0 * BODY.rotor_thrust_max_N * float(TOLD["MPC_THR_HOVER"])
    assert lift == pytest.approx(BODY.mass_kg * GRAVITY_MPS2, rel=0.01)
    assert TOLD["THR_MDL_FAC"] == 0.0  # the body's thrust is linear in the command


def test_gains_are_the_vehicles_and_integers_stay_integers():
    assert TOLD["MC_PITCHRATE_P"] == VEHICLE.cascade.roll_pitch_rate_p_s
    assert "MC_ROLL_P" not in TOLD
    said = px4_sitl.environment({"EKF2_EV_CTRL": 11, "EKF2_EVP_NOISE": 0.01}, "none_iris")
    assert said == {"PX4_SIM_MODEL": "none_iris", "PX4_PARAM_EKF2_EV_CTRL": "11", "PX4_PARAM_EKF2_EVP_NOISE": "0.01"}
