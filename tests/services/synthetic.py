"""A session made up from geometry alone: every topic, at its rate, with known answers, and no physics in the loop."""

from collections.abc import Iterator
from pathlib import Path as File
from typing import Any

import numpy as np

from schemas import topics
from schemas.energy import EnergyBalance
from schemas.estimation import CableForce, Tare
from schemas.guidance import GuidanceCommand
from schemas.health import Heartbeat
from schemas.message import Message, Quaternion, Vec3
from schemas.safety import Action, Level, OperatorReply, OperatorRequest, Phase, SafetyState
from schemas.simulation import Truth
from schemas.topics import Topic
from schemas.tracking import HandleSource, HandleState, MocapFrame, RigidBody, RobotPose
from schemas.vehicle import FlightMode, Setpoint, SetpointKind, ThrustSource, VehicleImu, VehicleState
from services.config import load
from services.guiding_controller.maneuver import f_d, p_R_d
from services.physics import Array
from services.recorder.writer import SessionWriter
from tests.services.synthetic_world import CABLE, PHASES, WEIGHT_N, Scenario, World

EPOCH_NS = 1_790_000_000_000_000_000
MONOTONIC_NS = 4_000_000_000_000
Sample = tuple[str, bytes, int]
GOOD = Scenario()
GUIDED_W = 0.2


def samples(scenario: Scenario) -> list[Sample]:
    """(key, payload, stamp) of every message that reaches the recorder, in the order of their stamps."""
    said = [
        (topic.key, message.model_dump_json().encode(), message.stamp_ns)
        for topic, messages in _Cast(World(scenario)).everything()
        for message in messages
        if message.seq not in scenario.dropped.get(topic.key, ())
    ]
    return sorted(said, key=lambda sample: sample[2])


def write(file: File, scenario: Scenario = GOOD, chunk_bytes: int = 65_536) -> File:
    """The session as the recorder would have left it."""
    logged = [topic for topic in topics.TOPICS if scenario.truth or topic is not topics.TRUTH]
    with SessionWriter(
        file,
        logged,
        epoch_ns=EPOCH_NS - MONOTONIC_NS,
        chunk_bytes=chunk_bytes,
        metadata={"profile": "synthetic", "seed": "1"},
        attachments={"config.json": load("demo").model_dump_json().encode()},
    ) as session:
        for n, (key, payload, stamp_ns) in enumerate(samples(scenario)):
            session.add(key, payload, stamp_ns + 1_000_000)
            if n % 250 == 249:
                session.flush()
    return file


class _Cast:
    """Each service's part."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.stamps: dict[str, Array] = {}
        self.rng = np.random.default_rng(1)

    def everything(self) -> Iterator[tuple[Topic[Any], list[Any]]]:
        w = self.world
        yield topics.MOCAP_FRAME, self.mocap()
        yield topics.HANDLE_STATE, self.handle()
        yield topics.ROBOT_POSE, self.pose()
        yield topics.VEHICLE_IMU, self.imu()
        yield topics.VEHICLE_STATE, self.vehicle()
        yield topics.CABLE_FORCE, self.cable()
        yield topics.GUIDANCE, self.guidance()
        yield topics.SAFETY_STATE, self.safety()
        yield topics.SETPOINT, self.setpoint()
        yield topics.ENERGY, self.energy()
        stamp: dict[str, Any] = {"seq": 1, "stamp_ns": _ns(np.array([w.start[Phase.TAKEOFF]]))[0]}
        yield topics.REQUEST, [OperatorRequest(**stamp, action=Action.START, operator="demo", request_id=7)]
        yield topics.REPLY, [OperatorReply(**stamp, request_id=7, accepted=True, text="starting")]
        if w.scenario.truth:
            yield topics.TRUTH, self.truth()
        for name, topic in topics.HEALTH.items():
            yield topic, self.health(name)

    def at(self, topic: Topic[Message], delay_s: float = 0.0) -> Array:
        """Times at which the topic is said, s."""
        t = np.arange(0.05, self.world.end_s, 1.0 / topic.rate_Hz) + delay_s
        self.stamps[topic.key] = t
        return t

    def heads(self, t: Array, *used: Topic[Message]) -> Iterator[dict[str, Any]]:
        """seq, stamp and the newest inputs, for each message."""
        newest = {u.key: np.searchsorted(self.stamps[u.key], t, side="right") for u in used}
        for i, stamp_ns in enumerate(_ns(t)):
            inputs = {key: int(seqs[i]) for key, seqs in newest.items() if seqs[i]}
            yield {"seq": i + 1, "stamp_ns": stamp_ns, "inputs": inputs}

    def mocap(self) -> list[Message]:
        t = self.at(topics.MOCAP_FRAME)
        bodies = zip(self.heads(t), self.world.robot(t), self.world.handle(t), strict=True)
        return [MocapFrame(**h, robot=_body(r), handle=_body(p)) for h, r, p in bodies]

    def handle(self) -> list[Message]:
        t = self.at(topics.HANDLE_STATE, 0.002)
        p, v = self.world.handle(t - 0.002), self.world.velocity(self.world.handle, t - 0.002)
        return [
            HandleState(
                **h, position_m=Vec3.of(p[i]), velocity_mps=Vec3.of(v[i]), source=HandleSource.MOCAP, lag_s=0.01
            )
            for i, h in enumerate(self.heads(t, topics.MOCAP_FRAME))
        ]

    def pose(self) -> list[Message]:
        t = self.at(topics.ROBOT_POSE, 0.002)
        p = self.world.robot(t)
        return [
            RobotPose(**h, position_m=Vec3.of(p[i]), q_WB_wxyz=Quaternion())
            for i, h in enumerate(self.heads(t, topics.MOCAP_FRAME))
        ]

    def imu(self) -> list[Message]:
        t = self.at(topics.VEHICLE_IMU)
        a = self.rng.normal(0.0, 0.05, (len(t), 3)) + (0.0, 0.0, 9.8)
        return [
            VehicleImu(
                **h,
                specific_force_B_mps2=Vec3.of(a[i]),
                angular_rate_B_rad_s=Vec3(),
                q_WB_wxyz=Quaternion(),
                thrust_N=8.0,
                thrust_source=ThrustSource.ACTUATOR_OUTPUTS,
            )
            for i, h in enumerate(self.heads(t))
        ]

    def vehicle(self) -> list[Message]:
        w, t = self.world, self.at(topics.VEHICLE_STATE)
        p, v = w.robot(t), w.velocity(w.robot, t)
        armed = (t > w.start[Phase.TAKEOFF]) & ((t < w.start[Phase.LANDED]) | (not w.scenario.lands))
        return [
            VehicleState(
                **h,
                connected=True,
                armed=bool(armed[i]),
                in_air=bool(armed[i]),
                mode=FlightMode.OFFBOARD,
                position_m=Vec3.of(p[i]),
                velocity_mps=Vec3.of(v[i]),
                q_WB_wxyz=Quaternion(),
                battery_fraction=0.8,
            )
            for i, h in enumerate(self.heads(t, topics.ROBOT_POSE))
        ]

    def cable(self) -> list[Message]:
        w, t = self.world, self.at(topics.CABLE_FORCE, 0.0005)
        true = w.force(t)
        f, taut = true + w.scenario.force_bias_N, true[:, 2] > 0.0
        return [
            CableForce(
                **h,
                force_N=Vec3.of(f[i]),
                observed_N=Vec3.of(f[i]),
                bias_N=Vec3(),
                bias_change_N=0.02,
                taut=bool(taut[i]),
                slack_m=-0.005,
                tare=Tare.PASSED,
                tare_report="bias 0.1 N",
            )
            for i, h in enumerate(self.heads(t, topics.VEHICLE_IMU, topics.HANDLE_STATE))
        ]

    def guidance(self) -> list[Message]:
        w, t = self.world, self.at(topics.GUIDANCE, 0.003)
        s = w.s(t)
        hand_d, robot_d, force_d = w.path.p(s), p_R_d(s, w.path, 1.0, CABLE), f_d(s, w.path, 1.0)
        u_A = 4.5 * (robot_d - w.robot(t)) * (1.0, 1.0, 0.0) + force_d
        return [
            GuidanceCommand(
                **h,
                valid=bool(w.start[Phase.GUIDING] <= t[i] < w.start[Phase.CLEARING]),
                s=s[i],
                path_length_m=w.path.length_m,
                p_H_d_m=Vec3.of(hand_d[i]),
                p_R_d_m=Vec3.of(robot_d[i]),
                f_d_N=Vec3.of(force_d[i]),
                scale=1.0,
                u_A_N=Vec3.of(u_A[i]),
                path_error_m=w.scenario.drift_m * np.sin(np.pi * s[i]),
            )
            for i, h in enumerate(self.heads(t, topics.HANDLE_STATE, topics.VEHICLE_STATE))
        ]

    def safety(self) -> list[Message]:
        w, t = self.world, self.at(topics.SAFETY_STATE, 0.001)
        phase, held = w.phase(t), w.held(t)
        return [
            SafetyState(
                **h,
                phase=PHASES[phase[i]][0],
                level=Level.OK,
                permit=PHASES[phase[i]][2],
                goal_m=Vec3(x=-2.0, y=-0.5, z=2.0),
                speed_mps=0.5,
                tare=PHASES[phase[i]][0] is Phase.ZEROING,
                held=bool(held[i]),
                reasons=[],
                stalls=w.scenario.stalls,
            )
            for i, h in enumerate(self.heads(t, topics.HANDLE_STATE, topics.CABLE_FORCE, topics.VEHICLE_STATE))
        ]

    def setpoint(self) -> list[Message]:
        w, t = self.world, self.at(topics.SETPOINT, 0.004)
        p, v, phase = w.robot(t) + w.scenario.robot_lag_m, w.velocity(w.robot, t), w.phase(t)
        used = (topics.VEHICLE_IMU, topics.CABLE_FORCE, topics.GUIDANCE, topics.SAFETY_STATE)
        return [
            Setpoint(
                **h,
                kind=SetpointKind.ADMITTANCE if PHASES[phase[i]][0] is Phase.GUIDING else SetpointKind.POSITION,
                position_m=Vec3.of(p[i]),
                velocity_mps=Vec3.of(v[i]),
                acceleration_mps2=Vec3(),
                yaw_rad=0.0,
                u_R_mps2=Vec3(),
                u_A_N=Vec3(),
                feed_forward=1.0,
                age_s=0.003 + 0.002 * abs(np.sin(7.0 * t[i])),
            )
            for i, h in enumerate(self.heads(t, *used))
        ]

    def energy(self) -> list[Message]:
        """Books that close: 0.2 W by guidance in phase 2, of which the cable takes half and damping the rest."""
        w, t = self.world, self.at(topics.ENERGY, 0.004)
        begin, end = w.start[Phase.GUIDING], w.start[Phase.ARRIVED]
        guided = np.clip(t - begin, 0.0, end - begin) * GUIDED_W
        made = np.where(t > begin + 2.0, w.scenario.made_J, 0.0)
        flies = (t >= begin) & (t < end)
        return [
            EnergyBalance(
                **h,
                stored_J=made[i],
                handed_J=0.0,
                guidance_J=guided[i],
                height_J=0.0,
                cable_J=-0.5 * guided[i],
                hand_J=0.0,
                dissipated_J=0.5 * guided[i],
                residual_J=-made[i],
                created_J=made[i],
                tank_J=8.0 - 0.5 * guided[i],
                tank_scale=1.0,
                damping_Ns_per_m=Vec3.of(2.4 * flies[i] * np.ones(3)),
            )
            for i, h in enumerate(self.heads(t, topics.CABLE_FORCE, topics.GUIDANCE, topics.SAFETY_STATE))
        ]

    def truth(self) -> list[Message]:
        w, t = self.world, self.at(topics.TRUTH)
        p_R, p_H, f, held = w.robot(t), w.handle(t), w.force(t), w.held(t)
        v_R, v_H = w.velocity(w.robot, t), w.velocity(w.handle, t)
        weight = np.array([0.0, 0.0, WEIGHT_N])
        return [
            Truth(
                **h,
                robot_position_m=Vec3.of(p_R[i]),
                robot_velocity_mps=Vec3.of(v_R[i]),
                robot_q_WB_wxyz=Quaternion(),
                hand_position_m=Vec3.of(p_H[i]),
                hand_velocity_mps=Vec3.of(v_H[i]),
                handle_position_m=Vec3.of(p_H[i]),
                handle_velocity_mps=Vec3.of(v_H[i]),
                head_position_m=Vec3.of(p_H[i] + (-0.35, 0.1, 0.6)),
                cable_force_N=Vec3.of(f[i]),
                hand_force_N=Vec3.of((f[i] - weight) * held[i]),
                holding=bool(held[i]),
                subject="walking",
            )
            for i, h in enumerate(self.heads(t))
        ]

    def health(self, name: str) -> list[Message]:
        t = self.at(topics.HEALTH[name], 0.3)
        return [
            Heartbeat(
                **h,
                service=name,
                pid=100,
                loop_rate_Hz=100.0,
                loop_lateness_p99_ms=0.8,
                missed_periods=3,
                longest_stall_ms=12.0,
                cpu_fraction=0.1,
                received={"handle/state": 60},
                rejected={},
                status="",
            )
            for h in self.heads(t)
        ]


def _ns(t: Array) -> list[int]:
    return [MONOTONIC_NS + round(1e9 * x) for x in t]


def _body(p: Array) -> RigidBody:
    return RigidBody(tracked=True, position_m=Vec3.of(p))
