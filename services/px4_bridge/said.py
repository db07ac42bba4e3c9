"""What the bridge says, made of what it knows: laws' states and the vehicle's samples as messages."""

import math
from collections.abc import Mapping

from schemas.energy import EnergyBalance
from schemas.message import Quaternion, Vec3
from schemas.vehicle import Setpoint, SetpointKind, VehicleImu, VehicleParameters, VehicleState
from services.px4_bridge import flight
from services.px4_bridge.telemetry import ImuSample, VehicleSample


def setpoint(output: flight.Output, yaw_rad: float, force_ns: int, now_ns: int, inputs: dict[str, int]) -> Setpoint:
    """What leaves for the autopilot; `force_ns` is the stamp of the cable force that it complies with, 0 for none."""
    complies = output.kind is not SetpointKind.POSITION
    return Setpoint(
        stamp_ns=now_ns,
        inputs=inputs,
        kind=output.kind,
        position_m=Vec3.of(output.sent.p),
        velocity_mps=Vec3.of(output.sent.v),
        acceleration_mps2=Vec3.of(output.sent.a),
        yaw_rad=yaw_rad,
        u_R_mps2=Vec3.of(output.u_R),
        u_A_N=Vec3.of(output.u_A),
        feed_forward=output.feed_forward,
        age_s=(now_ns - force_ns) * 1e-9 if complies and force_ns else 0.0,
    )


def parameters(found: Mapping[str, int | float]) -> VehicleParameters:
    """Integers are integers there too; one that is not finite is left out."""
    reals = {name: value for name, value in found.items() if isinstance(value, float) and math.isfinite(value)}
    return VehicleParameters(
        integers={name: value for name, value in found.items() if isinstance(value, int)}, reals=reals
    )


def balance(port: flight.Port, sent: Setpoint) -> EnergyBalance:
    """The books as they stood when the set-point left."""
    books = port.balance
    return EnergyBalance(
        stamp_ns=sent.stamp_ns,
        inputs=sent.inputs,
        stored_J=books.stored_J,
        handed_J=books.handed_J,
        guidance_J=books.guidance_J,
        height_J=books.height_J,
        cable_J=books.cable_J,
        hand_J=books.hand_J,
        dissipated_J=books.dissipated_J,
        residual_J=books.residual_J,
        created_J=books.created_J,
        tank_J=port.tank.level_J,
        tank_scale=port.tank.scale,
        damping_Ns_per_m=Vec3.of(port.damping),
    )


def imu(sample: ImuSample) -> VehicleImu:
    """One inertial sample."""
    return VehicleImu(
        stamp_ns=sample.stamp_ns,
        specific_force_B_mps2=Vec3.of(sample.specific_force_B),
        angular_rate_B_rad_s=Vec3.of(sample.angular_rate_B),
        q_WB_wxyz=Quaternion.of(sample.q_WB_wxyz),
        thrust_N=sample.thrust_N,
        thrust_source=sample.thrust_source,
        throttle_mean=sample.throttle.mean,
        throttle_square_mean=sample.throttle.square,
    )


def vehicle_state(sample: VehicleSample) -> VehicleState:
    """The vehicle as the autopilot describes it."""
    return VehicleState(
        stamp_ns=sample.stamp_ns,
        valid=sample.connected and sample.has_position and sample.knows_time,
        invalid_reason=_trouble(sample),
        connected=sample.connected,
        armed=sample.armed,
        in_air=sample.in_air,
        mode=sample.mode,
        position_m=Vec3.of(sample.p_W),
        velocity_mps=Vec3.of(sample.v_W),
        q_WB_wxyz=Quaternion.of(sample.q_WB_wxyz),
        battery_fraction=sample.battery_fraction,
        battery_V=sample.battery_V,
        killed=sample.killed,
    )


def _trouble(sample: VehicleSample) -> str:
    if not sample.connected:
        return "no heartbeat from the autopilot"
    if not sample.has_position:
        return "the autopilot has no position: does it get poses?"
    return "" if sample.knows_time else "the autopilot does not know our clock yet: wait some seconds"
