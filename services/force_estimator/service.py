"""Listens to the vehicle's IMU; says the cable force at its rate. Tares when the supervisor asks for it."""

import numpy as np

from schemas.estimation import CableForce
from schemas.message import Vec3
from schemas.topics import CABLE_FORCE, HANDLE_STATE, ROBOT_POSE, SAFETY_STATE, VEHICLE_IMU
from schemas.tracking import HandleSource, HandleState, RobotPose
from schemas.vehicle import VehicleImu
from services.config import Config
from services.force_estimator import estimator
from services.force_estimator.estimator import Geometry, Sample
from services.physics import norm
from services.runtime.node import Node, used

LONGEST_STEP_S = 0.1
STUCK = 10  # samples that are exactly the same: an inertial sensor has noise


async def run(node: Node, config: Config) -> None:
    """One estimate per IMU sample."""
    p = config.force_estimator
    imu, safety = node.stream(VEHICLE_IMU), node.latest(SAFETY_STATE)
    handle, robot = node.latest(HANDLE_STATE), node.latest(ROBOT_POSE)
    out = node.publisher(CABLE_FORCE)
    state, last_ns, still, before = estimator.initial(), 0, 0, Vec3()
    async for sample in imu:
        dt_s = min(max((sample.stamp_ns - last_ns) * 1e-9, 1e-4), LONGEST_STEP_S)
        last_ns = sample.stamp_ns
        still = still + 1 if sample.specific_force_B_mps2 == before else 0
        before = sample.specific_force_B_mps2
        verdict = safety.value
        cable = _geometry(handle.value, robot.value, held=verdict is not None and verdict.held)
        zero_now = verdict is not None and verdict.tare
        state, estimate = estimator.step(
            state, _sample(sample, dt_s), cable, zero_now, config.cable.rest_length_m, p.observer, p.bias
        )
        message = _message(sample, state, estimate, used(imu, handle, robot, safety))
        stuck = "the inertial sensor says the same for ever" if still > STUCK else ""
        node.status = stuck or state.report or f"tare {state.tare}"
        out.publish(message.model_copy(update={"valid": not stuck, "invalid_reason": stuck}))


def _sample(imu: VehicleImu, dt_s: float) -> Sample:
    return Sample(imu.specific_force_B_mps2.array(), imu.q_WB_wxyz.array(), imu.thrust_N, dt_s)


def _geometry(handle: HandleState | None, robot: RobotPose | None, *, held: bool) -> Geometry:
    if handle is None or robot is None or handle.source is not HandleSource.MOCAP:
        return Geometry(np.zeros(3), seen=False, held=held)
    return Geometry(robot.position_m.array() - handle.position_m.array(), seen=True, held=held)


def _message(
    imu: VehicleImu, state: estimator.State, estimate: estimator.Estimate, inputs: dict[str, int]
) -> CableForce:
    return CableForce(
        stamp_ns=imu.stamp_ns,
        inputs=inputs,
        force_N=Vec3.of(estimate.f_c),
        observed_N=Vec3.of(estimate.observed),
        bias_N=Vec3.of(state.zero + state.change),
        bias_change_N=float(norm(state.change)),
        taut=estimate.taut,
        slack_m=estimate.slack_m,
        tare=state.tare,
        tare_report=state.report,
    )
