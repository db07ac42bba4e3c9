"""Closed-loop flight on a virtual clock: the control cascade flies the rigid body through latencies, many vehicles at once.

The harness owns what a law must not: the clock, the delay lines, the loading of a vehicle's file.
"""

import tomllib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from services.simulator import cascade, quadrotor
from services.simulator.cascade import Cascade, CascadeState, Estimate, Setpoint
from services.simulator.imu import Imu
from services.simulator.quadrotor import Quadrotor, QuadrotorState

Array = NDArray[np.float64]

VEHICLES = Path(__file__).parent.parent / "deploy" / "vehicles"
TICK_S = 0.004
SUBSTEPS = 4


class Vehicle(NamedTuple):
    body: Quadrotor
    control: Cascade
    imu: Imu


def load(name: str) -> Vehicle:
    """A vehicle of deploy/vehicles."""
    values = tomllib.loads((VEHICLES / f"{name}.toml").read_text())
    return Vehicle(Quadrotor(**values["quadrotor"]), Cascade(**values["cascade"]), Imu(**values["imu"]))


@dataclass(frozen=True)
class Latency:
    """Whole ticks of 4 ms from the truth to the control's estimate, and from a set-point to its use."""

    estimate: int = 2
    setpoint: int = 2


class Flight:
    """One or many equal vehicles in the air; `tick` advances 4 ms.

    `estimate_offset_W` is what the position estimate is wrong by, in metres.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        p_W: Array,
        latency: Latency | None = None,
        estimate_offset_W: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        self.vehicle = vehicle
        self.state: QuadrotorState = quadrotor.at_rest(p_W, vehicle.body, hovering=True)
        self.motor = np.full(p_W.shape[:-1] + (4,), vehicle.control.hover_thrust)
        latency = latency or Latency()
        self._estimate_offset_W = np.asarray(estimate_offset_W)
        self._estimates = deque([self._believe()] * latency.estimate)
        self._setpoints: deque[Setpoint] = deque()
        self._setpoint_delay = latency.setpoint
        self._control: CascadeState = cascade.initial(self._believe(), vehicle.control)

    def tick(self, setpoint: Setpoint, force: Callable[[QuadrotorState], Array]) -> None:
        """One control step with delayed inputs, then the physics under `force(state)`, N in the world."""
        self._estimates.append(self._believe())
        self._setpoints.append(setpoint)
        used = self._setpoints.popleft() if len(self._setpoints) > self._setpoint_delay else self._setpoints[0]
        self._control, self.motor = cascade.step(
            self._control, self._estimates.popleft(), used, TICK_S, self.vehicle.control
        )
        for _ in range(SUBSTEPS):
            pull = force(self.state)
            self.state = quadrotor.step(self.state, self.motor, pull, TICK_S / SUBSTEPS, self.vehicle.body)

    def _believe(self) -> Estimate:
        state = self.state
        return Estimate(state.p_W + self._estimate_offset_W, state.v_W, state.q_WB_wxyz, state.omega_B)
