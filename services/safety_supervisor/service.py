"""Listens to everyone; says at 100 Hz which phase we are in, what the bridge may do, and what limits it now."""

from typing import Any, NamedTuple

import numpy as np

from schemas.estimation import Tare
from schemas.message import Vec3
from schemas.safety import Action, Level, OperatorReply, OperatorRequest, Phase, SafetyState
from schemas.topics import (
    CABLE_FORCE,
    ENERGY,
    GUIDANCE,
    HANDLE_STATE,
    RADIO_CLOCK,
    REPLY,
    REQUEST,
    ROBOT_POSE,
    SAFETY_STATE,
    SETPOINT,
    VEHICLE_STATE,
)
from schemas.tracking import HIDDEN, HandleSource
from schemas.vehicle import FlightMode, VehicleState
from services.config import Config
from services.physics import Array, dot, norm
from services.runtime.node import Node, Tick, used
from services.runtime.readers import Latest
from services.safety_supervisor import absence, caught, distances, held, lag, phases, rules
from services.safety_supervisor.novelty import Novelty
from services.safety_supervisor.plan import hall, plan
from services.safety_supervisor.requests import Requests
from services.safety_supervisor.rules import Facts, Rule

STRETCH_M = 0.1  # no cable: a hand that is seen further away is seen where it is not


class Senses:
    """The supervisor's ears: one reader per topic it judges by."""

    def __init__(self, node: Node) -> None:
        self.handle, self.robot_pose = node.latest(HANDLE_STATE), node.latest(ROBOT_POSE)
        self.vehicle = node.latest(VEHICLE_STATE)
        self.force = node.latest(CABLE_FORCE)
        self.guidance = node.latest(GUIDANCE)
        self.setpoint = node.latest(SETPOINT)
        self.energy = node.latest(ENERGY)
        self.requests = node.queue(REQUEST)
        self.clocks = node.latest(RADIO_CLOCK) if node.hosts.two else None
        measured = (self.handle, self.robot_pose, self.vehicle, self.force, self.guidance)
        self.novelty = {reader.topic.key: Novelty() for reader in measured}
        self.absence = absence.State()
        self.lag_s = 0.0

    def wait(self, tick: Tick, stall_s: float) -> None:
        """What passes with a turn."""
        missed_s, sent = tick.missed / SAFETY_STATE.rate_Hz, self.setpoint.value
        self.absence = absence.step(self.absence, missed_s, tick.dt_s, stall_s)
        self.lag_s = lag.step(self.lag_s, sent.age_s if sent else 0.0, tick.dt_s)

    def age_s(self, reader: Latest[Any]) -> float:
        """Since a valid message last said something new, as far as it was listened to; infinite for an invalid one or none."""
        if reader.message is None or not reader.message.valid:
            return float("inf")
        novelty = self.novelty.get(reader.topic.key)
        age_s = reader.age_s if novelty is None else novelty.age_s(reader.message, reader.age_s)
        return max(age_s - self.absence.away_s, 0.0)

    def inputs(self, tick: Tick) -> dict[str, int]:
        """What a verdict was made of."""
        seen, told = (
            (self.handle, self.robot_pose),
            (self.vehicle, self.force, self.guidance, self.setpoint, self.energy),
        )
        clocks = (self.clocks,) if self.clocks else ()
        return used(*seen, *told, self.requests, *clocks, tick=tick)


class Person(NamedTuple):
    """What is believed of the person: whether they hold the handle, which way they face, and what else holds the cable."""

    held: held.State
    ahead: Array
    cable: caught.State = caught.State()
    caught_m: float = 0.0


async def run(node: Node, config: Config) -> None:
    """One verdict per tick."""
    p, path = config.safety_supervisor, config.guided_path
    senses = Senses(node)
    out, replies = node.publisher(SAFETY_STATE), node.publisher(REPLY)
    weight_N = config.px4_bridge.flight.handle_weight_N
    route = plan(path, config.cable, weight_N, p.below_m, p.away_m, p.aside_m)
    volume = np.array(config.world.volume_min_m), np.array(config.world.volume_max_m)
    route = route._replace(hall=hall(path, config.cable, weight_N, *volume))
    person = Person(held.start(p.held), path.t_hat(0.0))
    state, broken, stalls, requests = phases.PhaseState(), rules.initial(), 0, Requests()
    async for tick in node.ticks(SAFETY_STATE.rate_Hz):
        senses.wait(tick, p.limits.stall_s)
        person = _observe(person, senses, tick.dt_s, config)
        facts = _facts(senses, person, tick.missed / SAFETY_STATE.rate_Hz, config)
        stalls += facts.stall_s > p.limits.stall_s
        request = requests.next(senses.requests.drain())
        action = request.action if request else None
        broken, active = rules.step(broken, facts, state.phase, action is Action.RESUME, tick.dt_s, p.limits)
        seen = _seen(action, active, senses, bool(person.held.held), path.p(1.0))
        state, decision = phases.step(state, seen, tick.dt_s, route, p.times)
        if request:
            requests.answered(_reply(request, state, active, senses))
        for reply in requests.replies():
            replies.publish(reply)
        node.status = f"{state.phase} {state.why}".strip()
        out.publish(
            SafetyState(
                inputs=senses.inputs(tick),
                phase=state.phase,
                level=max(seen.level, state.operator_level),
                permit=decision.permit,
                goal_m=Vec3.of(decision.goal),
                speed_mps=decision.speed_mps,
                tare=decision.tare,
                held=bool(person.held.held),
                reasons=_reasons(state, active, senses),
                stalls=stalls,
            )
        )


def _observe(person: Person, senses: Senses, dt: float, config: Config) -> Person:
    """Held or not, caught or not, and the way the person faces, from what is known now."""
    hand, robot, force, sent = senses.handle.value, senses.vehicle.value, senses.force.value, senses.setpoint.value
    if hand is None or robot is None or force is None:
        return person._replace(caught_m=0.0)
    x = held.Input(
        p_H=hand.position_m.array(),
        v_H=hand.velocity_mps.array(),
        seen=hand.source is HandleSource.MOCAP,
        p_R=robot.position_m.array(),
        f_c=force.force_N.array(),
        u_A=sent.u_A_N.array() if sent else np.zeros(3),
    )
    p, rest_length_m = config.safety_supervisor.held, config.cable.rest_length_m
    state, _ = held.step(person.held, x, dt, config.world.hand_height_m, rest_length_m, p)
    l_c, dl_c = x.p_R - x.p_H, robot.velocity_mps.array() - x.v_H
    on_it, caught_m = caught.step(person.cable, l_c, dl_c, x.f_c, dt, rest_length_m, p.handle_weight_N)
    return Person(state, distances.facing(person.ahead, x.p_R, x.p_H), on_it, caught_m if x.seen else 0.0)


def _facts(senses: Senses, person: Person, stall_s: float, config: Config) -> Facts:
    """What the rules are judged by; what is unknown is judged by its age, not by a guess."""
    hand, robot, force = senses.handle.message, senses.vehicle.message, senses.force.message
    energy = senses.energy.message
    clock = senses.clocks.value if senses.clocks else None
    p, world = config.safety_supervisor, config.world
    p_R = robot.position_m.array() if robot else np.zeros(3)
    p_H = hand.position_m.array() if hand and hand.valid else p_R - np.array([0.0, 0.0, config.cable.rest_length_m])
    near = distances.measure(
        p_R,
        p_H,
        person.ahead,
        np.array(world.volume_min_m),
        np.array(world.volume_max_m),
        config.px4_bridge.flight.ceiling_m + p.ceiling_margin_m,
        p.envelope,
    )
    weight = np.array([0.0, 0.0, config.px4_bridge.flight.handle_weight_N])
    pull = float(norm(force.force_N.array() - weight)) if force and person.held.held else 0.0
    return Facts(
        handle_age_s=senses.age_s(senses.handle),
        robot_pose_age_s=senses.age_s(senses.robot_pose),
        robot_apart_m=_apart_m(senses),
        vehicle_age_s=senses.age_s(senses.vehicle),
        force_age_s=senses.age_s(senses.force),
        guidance_age_s=senses.age_s(senses.guidance),
        setpoint_age_s=senses.age_s(senses.setpoint),
        force_aside_N=_aside_N(senses, config),
        offboard=robot is not None and robot.mode is FlightMode.OFFBOARD,
        autopilot_lands=robot is not None and robot.armed and robot.mode in (FlightMode.LAND, FlightMode.DESCEND),
        hand_force_N=pull,
        head_clearance_m=float(near.head) if person.held.held else np.inf,
        hand_clearance_m=float(near.hand) if person.held.held else np.inf,
        robot_outside_m=float(near.outside),
        above_ceiling_m=float(near.above),
        bias_change_N=force.bias_change_N if force else 0.0,
        energy_created_J=energy.created_J if energy else 0.0,
        tank_scale=energy.tank_scale if energy else 1.0,
        battery_fraction=robot.battery_fraction if robot else 1.0,
        killed=robot is not None and robot.killed,
        stall_s=stall_s,
        clock_uncertainty_s=_clock_uncertainty_s(senses),
        time_of_day_apart_s=abs(clock.time_of_day_apart_s) if clock else 0.0,
        loop_lag_s=senses.lag_s,
        cable_short_m=_short_m(senses, config),
        cable_caught_m=person.caught_m,
    )


def _apart_m(senses: Senses) -> float:
    """How far motion capture and the autopilot disagree about where the vehicle is."""
    pose, robot = senses.robot_pose.value, senses.vehicle.value
    return float(norm(pose.position_m.array() - robot.position_m.array())) if pose and robot else 0.0


def _short_m(senses: Senses, config: Config) -> float:
    """How much nearer the handle is seen than the cable is long; 0 where it is not seen."""
    hand, pose = senses.handle.value, senses.robot_pose.value
    if hand is None or hand.source is not HandleSource.MOCAP or pose is None:
        return 0.0
    return config.cable.rest_length_m - float(norm(pose.position_m.array() - hand.position_m.array()))


def _aside_N(senses: Senses, config: Config) -> float:
    """How much of the estimated force is not along a cable that is seen taut."""
    hand, pose, force = senses.handle.value, senses.robot_pose.value, senses.force.value
    if hand is None or hand.source is not HandleSource.MOCAP or pose is None or force is None:
        return 0.0
    l_c, f_c = pose.position_m.array() - hand.position_m.array(), force.force_N.array()
    length = float(norm(l_c))
    if not 0.0 <= length - config.cable.rest_length_m <= STRETCH_M:
        return 0.0
    return float(norm(f_c - dot(f_c, l_c) / length**2 * l_c))


def _clock_uncertainty_s(senses: Senses) -> float:
    if senses.clocks is None:
        return 0.0
    clock = senses.clocks.value
    return clock.uncertainty_s if clock else float("inf")


def _seen(action: Action | None, active: list[Rule], senses: Senses, is_held: bool, end: Array) -> phases.Seen:
    hand, robot, force = senses.handle.value, senses.vehicle.message, senses.force.message
    away = hand.position_m.array() - end if hand else np.full(3, np.inf)
    return phases.Seen(
        action=action,
        level=active[0].level if active else Level.OK,
        p_R=robot.position_m.array() if robot else np.zeros(3),
        v_R=robot.velocity_mps.array() if robot else np.full(3, np.inf),
        armed=_armed(robot),
        tare=force.tare if force else Tare.NONE,
        held=is_held,
        end_distance_m=float(np.hypot(away[0], away[1])),
    )


def _armed(robot: VehicleState | None) -> bool | None:
    """A bridge that has begun anew says its word before it has heard the autopilot's."""
    return robot.armed if robot and (robot.armed or robot.connected) else None


def _reasons(state: phases.PhaseState, active: list[Rule], senses: Senses) -> list[str]:
    """The gravest first, after what a person asked for; then why this phase was entered, and what zeroing says."""
    texts = [f"{rule.text}: {_cause(rule, senses) or rule.cure}" for rule in active]
    if state.operator_level >= Level.EASE:
        told = f"a person asked to {state.operator_level.name.lower()}"
        at = sum(rule.level >= Level.KILL for rule in active)
        texts.insert(at, f"{told}: clew resume goes on" if state.operator_level < Level.LAND else told)
    force = senses.force.message
    if force and force.tare is Tare.FAILED:
        texts.append(f"zeroing failed: {force.tare_report}")
    return texts + ([state.why] if state.why else [])


def _cause(rule: Rule, senses: Senses) -> str:
    """Of a hidden handle the tracker may know more: which body there is not, or that the world lies on its side."""
    hand = senses.handle.message
    if hand is None or hand.valid or hand.invalid_reason.startswith(HIDDEN) or not rule.name.startswith("handle_"):
        return ""
    return hand.invalid_reason


def _reply(request: OperatorRequest, state: phases.PhaseState, active: list[Rule], senses: Senses) -> OperatorReply:
    """What came of a request, in words."""
    not_started = request.action is Action.START and state.phase is Phase.IDLE
    limited = [rule for rule in active if rule.level >= Level.EASE]
    not_resumed = request.action is Action.RESUME and (state.phase is Phase.HOLD or bool(limited))
    refused = not_started or not_resumed
    why = "; ".join(": ".join(filter(None, (rule.text, _cause(rule, senses)))) for rule in active)
    text = why or "not ready" if refused else f"phase {state.phase}"
    return OperatorReply(request_id=request.request_id, accepted=not refused, text=text)
