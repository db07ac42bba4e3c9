"""One service by itself on the memory bus and virtual time: a test says what the others say, and reads what it answers."""

import asyncio
from collections import defaultdict
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from typing import Any, TypeAlias

import numpy as np

from schemas.estimation import CableForce, Tare
from schemas.message import Message, Quaternion, Vec3
from schemas.safety import Level, Permit, Phase, SafetyState
from schemas.topics import TOPICS, Topic
from schemas.tracking import HandleSource, HandleState, MocapFrame, RigidBody, RobotPose
from schemas.vehicle import FlightMode, Setpoint, SetpointKind, ThrustSource, VehicleImu, VehicleState
from services.physics import Array
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node
from services.runtime.virtual import VirtualClock, run_virtual

Said: TypeAlias = dict[str, list[Any]]
Feed: TypeAlias = Callable[[float], Message | None]
"""A message from the time since the beginning in s; None is silence."""

ZERO = Vec3()


class Alone:
    """The service under test and the others' voices."""

    def __init__(self) -> None:
        self.clock, self.bus = VirtualClock(), MemoryBus()
        self.said: Said = defaultdict(list)
        self.task: asyncio.Task[None] | None = None
        self._began_ns = self.clock.now_ns()
        self._nodes: dict[str, Node] = {}
        for topic in TOPICS:
            self.bus.subscribe(topic.key, lambda key, payload, t=topic: self._heard(t, key, payload))

    @property
    def now_s(self) -> float:
        """Since the beginning."""
        return (self.clock.now_ns() - self._began_ns) * 1e-9

    def node(self, name: str) -> Node:
        """Of the service under test, or of one that is played."""
        return self._nodes.setdefault(name, Node(name, self.bus, self.clock))

    def say(self, topic: Topic[Any], message: Message) -> Message:
        """As the topic's publisher."""
        return self.node(topic.publisher).publisher(topic).publish(message)

    async def repeat(self, topic: Topic[Any], feed: Feed) -> None:
        """At the table's rate."""
        while True:
            await asyncio.sleep(1.0 / topic.rate_Hz)
            message = feed(self.now_s)
            if message is not None:
                self.say(topic, message)

    def _heard(self, topic: Topic[Any], key: str, payload: bytes) -> None:
        self.said[key].append(topic.type.model_validate_json(payload))


def alone(
    service: Callable[[Alone], Coroutine[Any, Any, None]],
    feeds: Mapping[Topic[Any], Feed],
    script: Callable[[Alone], Awaitable[object]],
) -> Said:
    """Run the service under the feeds while the script lasts; everything that was said. A service that ends fails."""

    async def main() -> Said:
        stage = Alone()
        stage.task = asyncio.create_task(service(stage))
        tasks = [stage.task, *(asyncio.create_task(stage.repeat(topic, feed)) for topic, feed in feeds.items())]
        try:
            await script(stage)
            if stage.task.done() and not stage.task.cancelled():
                stage.task.result()
                raise AssertionError("the service came to an end")
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        return stage.said

    return run_virtual(main(), limit_s=60.0)


def lasting(seconds: float) -> Callable[[Alone], Awaitable[object]]:
    """A script that only waits."""
    return lambda _: asyncio.sleep(seconds)


def since(said: Said, topic: Topic[Any], t_s: float) -> list[Any]:
    """What was said of a topic from `t_s` on; counted as `Alone.now_s`."""
    return [m for m in said[topic.key] if m.stamp_ns * 1e-9 - 1.0 > t_s]


def rate_Hz(messages: list[Any]) -> float:
    """Of the stamps, on average."""
    return (len(messages) - 1) / ((messages[-1].stamp_ns - messages[0].stamp_ns) * 1e-9)


# What the others say.


def frame(robot: Array, handle: Array | None) -> MocapFrame:
    """None hides the handle."""
    body = RigidBody(tracked=True, position_m=Vec3.of(robot))
    seen = RigidBody(tracked=False) if handle is None else RigidBody(tracked=True, position_m=Vec3.of(handle))
    return MocapFrame(robot=body, handle=seen)


def vehicle(p_R: Array, *, armed: bool = True, mode: FlightMode = FlightMode.OFFBOARD) -> VehicleState:
    return VehicleState(
        connected=True,
        armed=armed,
        in_air=armed,
        mode=mode,
        position_m=Vec3.of(p_R),
        velocity_mps=ZERO,
        q_WB_wxyz=Quaternion(),
        battery_fraction=0.9,
    )


def force(f_c: Array, *, slack_m: float = 0.0) -> CableForce:
    return CableForce(
        force_N=Vec3.of(f_c),
        observed_N=Vec3.of(f_c),
        bias_N=ZERO,
        bias_change_N=0.0,
        taut=bool(np.any(f_c)),
        slack_m=slack_m,
        tare=Tare.PASSED,
        tare_report="",
    )


def handle(p_H: Array) -> HandleState:
    return HandleState(position_m=Vec3.of(p_H), velocity_mps=ZERO, source=HandleSource.MOCAP, lag_s=0.0)


def pose(p_R: Array) -> RobotPose:
    return RobotPose(position_m=Vec3.of(p_R), q_WB_wxyz=Quaternion())


def inertial(f_c: Array, mass_kg: float, thrust_N: float) -> VehicleImu:
    """Level hover thrust under the cable's pull."""
    felt = (np.array([0.0, 0.0, thrust_N]) - f_c) / mass_kg
    return VehicleImu(
        specific_force_B_mps2=Vec3.of(felt),
        angular_rate_B_rad_s=ZERO,
        q_WB_wxyz=Quaternion(),
        thrust_N=thrust_N,
        thrust_source=ThrustSource.ACTUATOR_OUTPUTS,
    )


def verdict(
    phase: Phase, permit: Permit, goal: Array | None = None, *, held: bool = False, tare: bool = False
) -> SafetyState:
    return SafetyState(
        phase=phase,
        level=Level.OK,
        permit=permit,
        goal_m=Vec3.of(np.zeros(3) if goal is None else goal),
        speed_mps=0.6,
        tare=tare,
        held=held,
        reasons=[],
        stalls=0,
    )


def setpoint() -> Setpoint:
    return Setpoint(
        kind=SetpointKind.POSITION,
        position_m=ZERO,
        velocity_mps=ZERO,
        acceleration_mps2=ZERO,
        yaw_rad=0.0,
        u_R_mps2=ZERO,
        u_A_N=ZERO,
        feed_forward=0.0,
        age_s=0.0,
    )
