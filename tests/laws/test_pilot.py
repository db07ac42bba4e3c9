"""The stand-in's clock while the host takes the processor away: the world stands still, time does not."""

import numpy as np
import pytest

from services.config import load
from services.physics import GRAVITY_MPS2
from services.px4_bridge.telemetry import HostTime
from services.simulator import quadrotor
from services.simulator.autopilot import STEP_S, Link, Sensors
from services.simulator.pilot import StandIn

AT_REST = Sensors(np.array([0.0, 0.0, GRAVITY_MPS2]), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))


class Wire(Link):
    def __init__(self):
        self.sent_s = []

    def receive(self):
        return []

    def send(self, state, sensors, output):
        self.sent_s.append(state.t_s)


def test_a_stall_of_the_host_is_no_delay_of_the_link():
    """Else the vehicle's stamps, mapped onto the host's clock, would be late by the stall from then on."""
    config, wire = load("demo"), Wire()
    robot = quadrotor.at_rest(np.zeros(3), config.vehicle.quadrotor)
    pilot, host = StandIn(config.simulator.autopilot, robot, wire), HostTime()
    host_s, late_s = 100.0, []
    for n in range(500):
        if n == 250:
            pilot.miss(0.3)
            host_s += 0.3
        pilot.sense(AT_REST)
        host_s += STEP_S
        stamp_ns = host.stamp_ns(round(wire.sent_s[-1] * 1e9), round(host_s * 1e9))
        late_s.append(host_s - stamp_ns * 1e-9)
    assert wire.sent_s[250] - wire.sent_s[249] == pytest.approx(0.3 + STEP_S)
    assert max(late_s) < 1e-3
