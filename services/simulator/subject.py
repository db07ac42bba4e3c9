"""The simulated subject of an experiment: who stands clear, takes the handle, walks with it, and lets go.

| here | meaning | unit | frame |
|---|---|---|---|
| told_to_take, told_to_let_go | what the experimenter says, as levels | | |
| p_handle_W | where the free handle hangs | m | W |
| f_c_W | cable force on the hand while it holds the handle | N | W |
| u_H_W | the subject's own force (a script of human.py) | N | W |

The phases follow the paper's experiment: Ph.1 the person stands clear, then takes the handle; Ph.2 walks with it (humanModel);
Ph.3 feels no horizontal force any more and lets go. One subject at a time: vectors are (3,).
"""

import math
from enum import Enum
from typing import NamedTuple

import numpy as np

from services.parameters import Positive, parameters
from services.physics import Array, clamp, components, saturate, vector
from services.simulator import human
from services.simulator.human import Human, HumanState

_AT_HEIGHT_M = 0.01


@parameters
class Subject:
    """How the subject moves the hand, and what makes them let go."""

    reach_speed_mps: Positive
    reach_rate_per_s: Positive
    hand_lag_s: Positive
    grasp_distance_m: Positive
    retreat_distance_m: Positive
    let_go_force_N: Positive
    let_go_after_s: Positive
    let_go_walked_m: Positive


class Phase(Enum):
    """What the subject is doing."""

    WAITING = "waiting"
    REACHING = "reaching"
    LIFTING = "lifting"
    HOLDING = "holding"
    LEAVING = "leaving"


HOLDS = (Phase.LIFTING, Phase.HOLDING)


class SubjectState(NamedTuple):
    """The moving person, the phase, and what the subject remembers."""

    person: HumanState
    phase: Phase
    goal_W: Array  # where the hand goes when it is free
    began_W: Array  # where holding began
    unpulled_s: float  # for how long no horizontal force has been felt
    was_told: bool  # so that taking the handle again needs a new word


class SubjectInput(NamedTuple):
    """What reaches the subject in one step."""

    p_handle_W: Array
    f_c_W: Array
    told_to_take: bool = False
    told_to_let_go: bool = False
    wants_to_let_go: bool = False
    u_H_W: Array = np.zeros(3)
    rise_m: float = 0.0
    """Above the hand's height, and at `rise_mps` where that is above 0."""
    rise_mps: float = 0.0
    down_N: float = 0.0
    """Pulls down with that, until the hand is `down_m` below its height."""
    down_m: float = 0.0


class SubjectOutput(NamedTuple):
    """What the world sees of the subject; while `holding`, the handle is at the hand."""

    p_hand_W: Array
    v_hand_W: Array
    holding: bool
    p_head_W: Array
    phase: Phase


def waiting(p_hand_W: Array, facing_W: Array) -> SubjectState:
    """A subject who stands still with the hand at `p_hand_W` and faces `facing_W` (horizontal, unit length)."""
    person = HumanState(p_hand_W.astype(float), np.zeros(3), facing_W.astype(float))
    return SubjectState(person, Phase.WAITING, person.p_H_W, person.p_H_W, 0.0, was_told=False)


def step(state: SubjectState, said: SubjectInput, dt: float, p: Subject, body: Human) -> SubjectState:
    """Decide, then move the hand by `dt`; `report` says what the world sees of it."""
    now = _decide(state, said, dt, p, body)
    person = _moved(now, said, dt, p, body)
    return SubjectState(person, now.phase, now.goal_W, now.began_W, now.unpulled_s, was_told=said.told_to_take)


def _moved(state: SubjectState, said: SubjectInput, dt: float, p: Subject, body: Human) -> HumanState:
    match state.phase:
        case Phase.WAITING:
            return state.person  # stands still
        case Phase.REACHING:
            return _reach(state.person, said.p_handle_W, dt, p)
        case Phase.LIFTING | Phase.HOLDING:
            return _walk(state, said, dt, p, body)
        case Phase.LEAVING:
            return _reach(state.person, state.goal_W, dt, p)


def report(state: SubjectState, body: Human) -> SubjectOutput:
    """The subject as the world sees it."""
    person = state.person
    head = human.head(person.p_H_W, person.facing_W, body)
    return SubjectOutput(person.p_H_W, person.v_H_W, state.phase in HOLDS, head, state.phase)


def _decide(state: SubjectState, said: SubjectInput, dt: float, p: Subject, body: Human) -> SubjectState:
    hand = state.person.p_H_W
    match state.phase:
        case Phase.WAITING | Phase.LEAVING if said.told_to_take and not state.was_told:
            return state._replace(phase=Phase.REACHING)
        case Phase.REACHING if not said.told_to_take:
            return _leave(state, p)
        case Phase.REACHING if math.dist(said.p_handle_W, hand) < p.grasp_distance_m:
            grasp = state.person._replace(p_H_W=said.p_handle_W.astype(float))  # the hand closes round it: no jerk
            return state._replace(phase=Phase.LIFTING, person=grasp)
        case Phase.LIFTING | Phase.HOLDING if said.told_to_let_go or said.wants_to_let_go:
            return _leave(state, p)
        case Phase.LIFTING if abs(hand[2] - body.hand_height_m) < _AT_HEIGHT_M:
            return state._replace(phase=Phase.HOLDING, began_W=hand, unpulled_s=0.0)
        case Phase.HOLDING:
            return _feel(state, said.f_c_W, dt, p)
        case _:
            return state


def _feel(state: SubjectState, f_c_W: Array, dt: float, p: Subject) -> SubjectState:
    """Let go when nothing has pulled sideways for a while, after a real walk."""
    pulled = math.hypot(*f_c_W[:2]) >= p.let_go_force_N
    walked = math.dist(state.person.p_H_W[:2], state.began_W[:2]) >= p.let_go_walked_m
    state = state._replace(unpulled_s=0.0 if pulled or not walked else state.unpulled_s + dt)
    return _leave(state, p) if state.unpulled_s >= p.let_go_after_s else state


def _leave(state: SubjectState, p: Subject) -> SubjectState:
    """Open the hand and step back, away from where the person faces."""
    away = state.person.p_H_W - p.retreat_distance_m * state.person.facing_W
    return state._replace(phase=Phase.LEAVING, goal_W=away, unpulled_s=0.0)


def _walk(state: SubjectState, said: SubjectInput, dt: float, p: Subject, body: Human) -> HumanState:
    """humanModel in the plane; the hand goes to its height smoothly, and the person stands firm until it is there."""
    person = state.person
    stand = -body.b_stop_Ns_per_m * person.v_H_W if state.phase is Phase.LIFTING else said.u_H_W
    after = human.step(person, said.f_c_W, stand, dt, body)
    (x, y, _), (v_x, v_y, _) = components(after.p_H_W), components(after.v_H_W)
    z, v_z = float(person.p_H_W[2]), float(person.v_H_W[2])
    if said.down_N:
        z, v_z = _pulled_down(z, v_z, said, dt, body)
        return HumanState(vector(x, y, z), vector(v_x, v_y, v_z), after.facing_W)
    fastest, height = said.rise_mps or p.reach_speed_mps, body.hand_height_m + said.rise_m
    climb = clamp(p.reach_rate_per_s * (height - z), -fastest, fastest)
    v_z -= math.expm1(-dt / p.hand_lag_s) * (climb - v_z)
    return HumanState(vector(x, y, z + dt * v_z), vector(v_x, v_y, v_z), after.facing_W)


def _pulled_down(z: float, v_z: float, said: SubjectInput, dt: float, body: Human) -> tuple[float, float]:
    """humanModel upright: the person's force against the cable's, until the arm is stretched."""
    lowest = body.hand_height_m - said.down_m
    a = (float(said.f_c_W[2]) - said.down_N - body.b_H_Ns_per_m * v_z) / body.m_H_kg
    below = z + dt * v_z
    return (lowest, 0.0) if below <= lowest and v_z <= 0.0 else (below, v_z + dt * a)


def _reach(person: HumanState, goal_W: Array, dt: float, p: Subject) -> HumanState:
    """Move the free hand to `goal_W`: at most at the reach speed, slower and slower towards the end."""
    wanted = saturate(p.reach_rate_per_s * (goal_W - person.p_H_W), p.reach_speed_mps)
    v = person.v_H_W - math.expm1(-dt / p.hand_lag_s) * (wanted - person.v_H_W)
    return HumanState(person.p_H_W + dt * v, v, person.facing_W)
