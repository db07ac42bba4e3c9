"""What the bridge asks of a vehicle, whether it is behind MAVLink or a double in a test."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.vehicle import FlightMode
from services.px4_bridge.telemetry import Checks, ImuSample, VehicleSample
from services.runtime.plain import PlainError

Array = NDArray[np.float64]

LINK_CURE = "check power, cable, port and baud rate of px4_bridge.link.url"


class VehicleError(PlainError):
    """The autopilot cannot be reached, refuses, or does not do what it acknowledged."""


class Vehicle(Protocol):
    """What the bridge asks of a vehicle; world ENU, body FLU. Orders raise VehicleError, none waits for ever."""

    @property
    def sample(self) -> VehicleSample:
        """The newest of everything."""
        ...

    async def wait_imu(self) -> None:
        """Until there is an inertial sample to drain; without an autopilot that is for ever."""
        ...

    def drain_imu(self) -> list[ImuSample]:
        """All inertial samples since the last call, oldest first."""
        ...

    def drain_texts(self) -> list[str]:
        """The autopilot's remarks since the last call."""
        ...

    def send_setpoint(self, p_W: Array | None, v_W: Array | None, a_W: Array | None, yaw_rad: float | None) -> None:
        """One set-point, sent once; None and NaN components are not set. Raises ValueError on an infinite one."""
        ...

    def send_pose(self, p_W: Array, q_WB_wxyz: Array, stamp_ns: int) -> None:
        """One motion-capture pose for the autopilot's estimator, taken at `stamp_ns` on this host's clock."""
        ...

    async def arm(self) -> None:
        """Start the motors."""
        ...

    async def disarm(self) -> None:
        """Stop the motors; refused in the air."""
        ...

    async def set_mode(self, mode: FlightMode) -> None:
        """Enter OFFBOARD, HOLD or LAND. Raises ValueError for any other."""
        ...

    async def kill(self) -> None:
        """Disarm at once, in the air too; it can be armed again."""
        ...

    async def terminate(self) -> None:
        """Stop the motors at once, in the air too, for good."""
        ...

    async def set_origin(self) -> None:
        """Tell the autopilot some place on earth, which it wants before it holds a position; it does not answer."""
        ...

    @property
    def checks(self) -> Checks:
        """What is looked at before a flight, as far as it has been told."""
        ...

    async def ask_version(self) -> None:
        """Let it tell its version, which is then among the checks."""
        ...

    async def arming_problems(self) -> list[str]:
        """What it has against arming in its present mode, in its own words; VehicleError where it does not give them."""
        ...

    async def get_parameters(self) -> dict[str, int | float]:
        """All of them."""
        ...

    async def get_parameter(self, name: str) -> int | float:
        """A parameter of the autopilot under its own name."""
        ...

    async def set_parameter(self, name: str, value: int | float) -> None:
        """Set a parameter; an int for one that is an integer there."""
        ...
