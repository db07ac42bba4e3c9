"""The simulated world in one step: vehicle, cable, handle and subject, coupled by the cable's force.

The handle is the cable's lower end: it moves with the hand while the subject holds it, and by its own dynamics while not.
The subject's script counts from the moment the handle is held. Pure: the motors come in, the world goes on by `dt`.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from services import cable
from services.cable import Cable
from services.physics import GRAVITY_MPS2, Array, Z
from services.simulator import handle, human, quadrotor, subject
from services.simulator.handle import Handle, HandleState
from services.simulator.human import Behaviour, Human
from services.simulator.quadrotor import Quadrotor, QuadrotorState
from services.simulator.subject import Subject, SubjectInput, SubjectOutput, SubjectState


@dataclass(frozen=True)
class WorldParams:
    """Everything that the world is made of."""

    quadrotor: Quadrotor
    cable: Cable
    handle: Handle
    human: Human
    subject: Subject
    behaviour: Behaviour


class WorldState(NamedTuple):
    """`f_c_W` acts on the handle, -f_c_W on the vehicle; `held_s` counts while the subject holds the handle."""

    robot: QuadrotorState
    handle: HandleState
    subject: SubjectState
    f_c_W: Array
    held_s: float


class Told(NamedTuple):
    """What the experimenter says to the subject."""

    take: bool = False
    let_go: bool = False


def initial(p_R: Array, p_handle: Array, p_hand: Array, facing_W: Array, p: WorldParams) -> WorldState:
    """Vehicle on the floor, handle on the floor beside it, subject clear of both; positions (3,) m."""
    floor = np.array([1.0, 1.0, 0.0])
    robot = quadrotor.at_rest(p_R * floor + p.quadrotor.gear_height_m * Z, p.quadrotor)
    lying = HandleState(p_handle * floor + p.handle.height_m * Z, np.zeros(3))
    return WorldState(robot, lying, subject.waiting(p_hand, facing_W), np.zeros(3), 0.0)


def step(state: WorldState, motor: Array, told: Told, dt: float, p: WorldParams) -> WorldState:
    """One step of `dt` (1 ms) with the motors' thrust fractions (4,) held."""
    f_c = cable.force(state.robot.p_W, state.handle.p_W, state.robot.v_W, state.handle.v_W, p.cable)
    robot = quadrotor.step(state.robot, motor, -f_c, dt, p.quadrotor)
    person = subject.step(state.subject, _said(state, f_c, told, p), dt, p.subject, p.human)
    if person.phase in subject.HOLDS:
        lower_end, held_s = HandleState(person.person.p_H_W, person.person.v_H_W), state.held_s + dt
    else:
        lower_end, held_s = handle.step(state.handle, f_c, dt, p.handle), 0.0
    return WorldState(robot, lower_end, person, f_c, held_s)


def _said(state: WorldState, f_c: Array, told: Told, p: WorldParams) -> SubjectInput:
    """What reaches the subject; the script counts only while the handle is held."""
    if state.subject.phase not in subject.HOLDS:
        return SubjectInput(state.handle.p_W, f_c, told.take, told.let_go)
    wish = human.u_H(state.held_s, state.subject.person, p.behaviour, p.human) + human.lean(f_c, p.human)
    opens = human.lets_go(state.held_s, p.behaviour)
    rise_m, rise_mps = human.rise(state.held_s, p.behaviour)
    down_N, down_m = human.pull_down(state.held_s, p.behaviour)
    return SubjectInput(state.handle.p_W, f_c, told.take, told.let_go, opens, wish, rise_m, rise_mps, down_N, down_m)


def look(state: WorldState, p: WorldParams) -> SubjectOutput:
    """The subject as the world sees it."""
    return subject.report(state.subject, p.human)


def hand_force(state: WorldState, p: WorldParams) -> Array:
    """What the hand feels in N, (3,): the cable's pull less the handle's weight; zero while it does not hold."""
    holds = state.subject.phase in subject.HOLDS
    return state.f_c_W - p.handle.mass_kg * GRAVITY_MPS2 * Z if holds else np.zeros(3)
