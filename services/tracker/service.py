"""Listens to motion capture; says where the hand is and how it moves, and the robot's pose for the autopilot."""

from typing import NamedTuple

import numpy as np

from schemas.estimation import CableForce, Tare
from schemas.message import Vec3
from schemas.topics import CABLE_FORCE, HANDLE_STATE, MOCAP_SEEN, ROBOT_POSE, VEHICLE_STATE
from schemas.tracking import HIDDEN, HandleSource, HandleState, MocapFrame, RobotPose
from schemas.vehicle import VehicleState
from services.config import Config
from services.physics import Array, norm
from services.runtime.node import Node, used
from services.runtime.readers import Latest
from services.tracker import axes, filtering, hand, robot
from services.tracker.filtering import Sample
from services.tracker.hand import Led
from services.tracker.robot import Belief
from services.tracker.sources import Source, open_source

LONGEST_STEP_S = 0.5
MARGIN_M = 0.01  # what motion capture and the autopilot may differ by about how near the hand is
ELSEWHERE = "the robot is seen where it does not fly"
DOUBTED = "the handle is seen where the cable does not lead"


class Felt(NamedTuple):
    """The force that was looked at last: one that is exactly what it was before has not been felt."""

    seq: int = 0
    force_N: Vec3 = Vec3()
    new: bool = False


async def run(node: Node, config: Config) -> None:
    """Follow the profile's capture system."""
    async with open_source(config.tracker, node) as source:
        await track(node, config, source)


async def track(node: Node, config: Config, source: Source) -> None:
    """One handle state and, while it is seen where it can be, one robot pose per frame."""
    p = config.tracker
    vehicle, force = node.latest(VEHICLE_STATE), node.latest(CABLE_FORCE)
    handles, robots = node.publisher(HANDLE_STATE), node.publisher(ROBOT_POSE)
    held, body, world, last_ns, felt = hand.start(), robot.start(), axes.start(), 0, Felt()
    async for taken in source.frames:
        frame = taken if taken.seq else node.publisher(MOCAP_SEEN).publish(taken)
        dt = min(max((frame.stamp_ns - last_ns) * 1e-9, 1e-4), LONGEST_STEP_S)
        last_ns = frame.stamp_ns
        belief = _belief(vehicle)
        if not belief.flying:
            world = _axes(world, frame, dt, p.axes)
        wrong = axes.complaint(world)
        z_R, q_R = frame.robot.position_m.array(), frame.robot.q_WB_wxyz.array()
        body, seen = robot.step(body, z_R, q_R, frame.robot.tracked, belief, dt, p.robot)
        inputs = {source.topic.key: frame.seq} | used(vehicle, force)
        if seen.valid and seen.sample in (Sample.ACCEPTED, Sample.RESTART) and not wrong:
            robots.publish(_pose(frame, inputs))
        jumped = seen.sample == Sample.JUMP
        tracked = frame.handle.tracked and not jumped
        felt = _felt(felt, force)
        led = _led(vehicle, force, config, hand.TAUT_N) if felt.new and _zeroed(force) else None
        aloft = vehicle.message is not None and vehicle.message.in_air
        held, found = hand.step(held, frame.handle.position_m.array(), tracked, led, aloft, dt, p.handle)
        # What contradicts itself is not guessed either: the world may have jumped, or the bodies changed places.
        against = wrong or ELSEWHERE * (jumped and not found.valid) or DOUBTED * held.doubted
        message = _seen(found, p.handle.tau_s) if found.valid else _guessed(vehicle, force, config)
        against = against or (frame.trouble if _missed(frame, message, belief) else "")
        message = _nothing(against) if against else message
        said = wrong or DOUBTED * held.doubted
        node.status = source.trouble() or said or f"handle by {message.source}, robot {_said(seen, z_R, belief)}"
        handles.publish(message.model_copy(update={"stamp_ns": frame.stamp_ns, "inputs": inputs}))


def _missed(frame: MocapFrame, message: HandleState, belief: Belief) -> bool:
    """Whether a body is missing that is needed now: on the ground both, so that a start is refused with the cause."""
    return not message.valid or not (belief.flying or frame.robot.tracked)


def _belief(vehicle: Latest[VehicleState]) -> Belief:
    """Where the autopilot believes to be; nowhere while it is armed and not heard. Without a position it follows nothing."""
    told = vehicle.message
    if told is None or not told.armed or not told.valid:
        return Belief(np.zeros(3), np.zeros(4), flying=False)
    p = told.position_m.array() if vehicle.fresh else np.full(3, np.inf)
    return Belief(p, told.q_WB_wxyz.array(), flying=True)


def _axes(world: axes.State, frame: MocapFrame, dt: float, p: axes.Axes) -> axes.State:
    if not (frame.robot.tracked and frame.handle.tracked):
        return world
    both = np.array((frame.robot.position_m.array(), frame.handle.position_m.array()))
    return axes.step(world, both, frame.robot.q_WB_wxyz.array(), dt, p)


def _said(seen: filtering.Output, z_R: Array, belief: Belief) -> str:
    away = f" {norm(z_R - belief.p):.2f} m from where it flies" if belief.flying else ""
    return Sample(int(seen.sample)).name.lower() + (away if seen.sample == Sample.JUMP else "")


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
    robot = vehicle.value
    if robot is None or force.value is None:
        return _nothing(f"{HIDDEN}, no vehicle or force to go by")
    led = _led(vehicle, force, config, config.tracker.fallback_force_min_N)
    if led is None:
        return _nothing(f"{HIDDEN}, cable not taut enough to show it")
    return _state(led.p_H, robot.velocity_mps.array(), HandleSource.CABLE, 0.0)


def _zeroed(force: Latest[CableForce]) -> bool:
    """What is not zeroed may be bias as well as pull (G8)."""
    return force.value is not None and force.value.tare is Tare.PASSED


def _felt(before: Felt, force: Latest[CableForce]) -> Felt:
    if force.value is None or force.value.seq == before.seq:
        return before if force.value else Felt()
    return Felt(force.value.seq, force.value.force_N, force.value.force_N != before.force_N)


def _led(vehicle: Latest[VehicleState], force: Latest[CableForce], config: Config, taut_N: float) -> Led | None:
    """Where a cable leads that pulls with more than `taut_N`; the floor under a landing vehicle pushes instead."""
    robot, pull = vehicle.value, force.value
    if robot is None or pull is None or pull.force_N.z < 0.0:
        return None
    p_R, f_c = robot.position_m.array(), pull.force_N.array()
    p_H, usable = filtering.fallback(p_R, f_c, config.cable, taut_N)
    if not usable:
        return None
    l_c = p_R - p_H
    length_m = float(norm(l_c))
    return Led(p_H, l_c / length_m, length_m - config.px4_bridge.flight.hand_clear_m - MARGIN_M)


def _nothing(why: str) -> HandleState:
    return _state(np.zeros(3), np.zeros(3), HandleSource.NONE, 0.0).model_copy(
        update={"valid": False, "invalid_reason": why}
    )


def _state(p_H: Array, v_H: Array, source: HandleSource, lag_s: float) -> HandleState:
    return HandleState(position_m=Vec3.of(p_H), velocity_mps=Vec3.of(v_H), source=source, lag_s=lag_s)
