"""Listens to motion capture; says where the hand is and how it moves, and the robot's pose for the autopilot."""

import numpy as np

from schemas.estimation import CableForce
from schemas.message import Vec3
from schemas.topics import CABLE_FORCE, HANDLE_STATE, MOCAP_FRAME, ROBOT_POSE, VEHICLE_STATE
from schemas.tracking import HandleSource, HandleState, MocapFrame, RobotPose
from schemas.vehicle import VehicleState
from services.config import Config
from services.physics import Array
from services.runtime.node import Node, used
from services.runtime.readers import Latest
from services.tracker import filtering
from services.tracker.sources import open_source

LONGEST_STEP_S = 0.5


async def run(node: Node, config: Config) -> None:
    """One handle state and, while it is seen, one robot pose per frame."""
    p = config.tracker
    vehicle, force = node.latest(VEHICLE_STATE), node.latest(CABLE_FORCE)
    handles, robots = node.publisher(HANDLE_STATE), node.publisher(ROBOT_POSE)
    hand, robot, last_ns = filtering.start(), filtering.start(), 0
    async for frame in open_source(p.source, node):
        dt = min(max((frame.stamp_ns - last_ns) * 1e-9, 1e-4), LONGEST_STEP_S)
        last_ns = frame.stamp_ns
        origin = {MOCAP_FRAME.key: frame.seq} if frame.seq else {}
        robot, seen = filtering.step(robot, frame.robot.position_m.array(), frame.robot.tracked, dt, p.robot)
        if seen.valid and seen.sample in (filtering.Sample.ACCEPTED, filtering.Sample.RESTART):
            robots.publish(_pose(frame, origin))
        hand, found = filtering.step(hand, frame.handle.position_m.array(), frame.handle.tracked, dt, p.handle)
        message = _seen(found, p.handle.tau_s) if found.valid else _guessed(vehicle, force, config)
        node.status = f"handle by {message.source}, robot {filtering.Sample(int(seen.sample)).name.lower()}"
        inputs = origin | ({} if message.source is HandleSource.MOCAP else used(vehicle, force))
        handles.publish(message.model_copy(update={"stamp_ns": frame.stamp_ns, "inputs": inputs}))


def _pose(frame: MocapFrame, inputs: dict[str, int]) -> RobotPose:
    """As measured: the autopilot's estimator filters by itself; jumps never reach it."""
    return RobotPose(
        stamp_ns=frame.stamp_ns,
        inputs=inputs,
        position_m=frame.robot.position_m,
        q_WB_wxyz=frame.robot.q_WB_wxyz,
    )


def _seen(found: filtering.Output, tau_s: float) -> HandleState:
    return _state(found.p, found.v, HandleSource.MOCAP, 2.0 * tau_s)


def _guessed(vehicle: Latest[VehicleState], force: Latest[CableForce], config: Config) -> HandleState:
    """From the robot and the cable force while the cable is taut (last remark), without a velocity."""
    robot, pull = vehicle.value, force.value
    if robot is None or pull is None:
        return _nothing("handle hidden, no vehicle or force to go by")
    p_H, usable = filtering.fallback(
        robot.position_m.array(), pull.force_N.array(), config.cable, config.tracker.fallback_force_min_N
    )
    if not usable:
        return _nothing("handle hidden, cable not taut enough to show it")
    return _state(p_H, robot.velocity_mps.array(), HandleSource.CABLE, 0.0)


def _nothing(why: str) -> HandleState:
    return _state(np.zeros(3), np.zeros(3), HandleSource.NONE, 0.0).model_copy(
        update={"valid": False, "invalid_reason": why}
    )


def _state(p_H: Array, v_H: Array, source: HandleSource, lag_s: float) -> HandleState:
    return HandleState(position_m=Vec3.of(p_H), velocity_mps=Vec3.of(v_H), source=source, lag_s=lag_s)
