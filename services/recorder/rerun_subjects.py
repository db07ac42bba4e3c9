"""Which services a rerun can run, and how each stands on a recording instead of on what it drives or reads."""

from collections.abc import Callable, Coroutine
from typing import Any, NamedTuple, cast

from schemas.message import Message
from schemas.topics import (
    CABLE_FORCE,
    ENERGY,
    GUIDANCE,
    HANDLE_STATE,
    REPLY,
    ROBOT_POSE,
    SAFETY_STATE,
    SETPOINT,
    VEHICLE_STATE,
    Topic,
)
from schemas.vehicle import VehicleState
from services.config import Config
from services.force_estimator import service as force_estimator
from services.guiding_controller import service as guiding_controller
from services.px4_bridge import service as px4_bridge
from services.px4_bridge.vehicle_protocol import Vehicle
from services.recorder.rerun_node import RerunNode
from services.runtime.node import Tick
from services.safety_supervisor import service as safety_supervisor
from services.tracker import service as tracker
from services.tracker import sources


class Subject(NamedTuple):
    """A service that can be run again. `turns` has one message for each turn of its loop, `also` the rest it says."""

    run: Callable[[RerunNode, Config], Coroutine[Any, Any, None]]
    turns: Topic[Message]
    also: tuple[Topic[Message], ...] = ()


async def _recorded_frames(node: RerunNode, config: Config) -> None:
    """The tracker on frames as they were recorded, whichever capture system they came from."""
    await tracker.track(node, config, sources.recorded(config.tracker, node))


async def _setpoints(node: RerunNode, config: Config) -> None:
    """The bridge's set-point loop on the vehicle states that it said."""
    await _RecordedBridge(node, config).stream_setpoints()


class _Nowhere:
    """Where the set-points of a rerun go; the set-point loop asks nothing else of a vehicle."""

    def send_setpoint(self, *_: object) -> None:
        """Sent to nobody."""


class _RecordedBridge(px4_bridge.Bridge):
    def __init__(self, node: RerunNode, config: Config) -> None:
        super().__init__(node, config, cast(Vehicle, _Nowhere()))
        self._robots = node.latest(VEHICLE_STATE)

    def report_vehicle(self, tick: Tick) -> VehicleState:
        robot = self._robots.message
        assert robot, "every set-point names a vehicle state"
        return robot


SUBJECTS = {
    "tracker": Subject(_recorded_frames, HANDLE_STATE, (ROBOT_POSE,)),
    "force_estimator": Subject(force_estimator.run, CABLE_FORCE),
    "guiding_controller": Subject(guiding_controller.run, GUIDANCE),
    "safety_supervisor": Subject(safety_supervisor.run, SAFETY_STATE, (REPLY,)),
    "px4_bridge": Subject(_setpoints, SETPOINT, (ENERGY,)),
}
