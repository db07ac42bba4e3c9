"""The experiment as an explicit state machine: which phase we are in and what the bridge may do in it.

A pure transition function over the phases of `schemas.safety.Phase`. The paper's Ph.1 is takeoff to ready, Ph.2 guiding,
Ph.3 arrived to landed. Levels come from the rules and from the operator; they override the phase's permit, never raise it.
KILLED is reached from every phase, by a person alone, and is left only with the process. A pilot's kill switch is a person's
word in flight; on the ground it only keeps the vehicle there.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.estimation import Tare
from schemas.safety import RAISES, Action, Level, Permit, Phase
from services.parameters import Positive, parameters

Array = NDArray[np.float64]


@parameters
class Times:
    """How long things last and how near is near."""

    settle_s: Positive
    settle_m: Positive
    settle_mps: Positive
    held_s: Positive
    """Held this long before the pull begins."""
    released_s: Positive
    """Not held this long, at the end, before the vehicle flies away."""
    regrasp_s: Positive
    """Not held this long under way before the session ends."""
    arrived_s: Positive
    arrived_m: Positive
    step_back_s: Positive
    """For the person to step back before the vehicle moves away."""
    takeoff_limit_s: Positive
    """For the take-off, and again for zeroing."""
    clearing_limit_s: Positive
    """Then it lands where it is: somebody may not have let go."""
    ready_limit_s: Positive
    fast_mps: Positive
    slow_mps: Positive


class Hall(NamedTuple):
    """What moves the clearing to where it begins: `end` is where it is drawn from, `low` and `high` where it may go, m in W."""

    end: Array
    low: Array
    high: Array


class Plan(NamedTuple):
    """Where the vehicle's centre goes in position mode, m in W."""

    start: Array
    """Hover over the start, the handle hanging at hand height."""
    clearing: tuple[Array, ...]
    """From above the end: away from the person, down until the handle rests on the floor, aside."""
    hall: Hall | None = None
    """Without it the clearing is flown as drawn."""


class Seen(NamedTuple):
    """What one tick shows."""

    action: Action | None
    level: Level
    p_R: Array
    v_R: Array
    armed: bool | None
    """None: nobody has heard it say so, and it may fly."""
    tare: Tare
    held: bool
    end_distance_m: float


class PhaseState(NamedTuple):
    """`timer_s` counts what the phase waits for, `away_s` how long nobody holds; `leg` is the leg of the clearing."""

    phase: Phase = Phase.IDLE
    in_phase_s: float = 0.0
    timer_s: float = 0.0
    away_s: float = 0.0
    leg: int = 0
    shift_m: tuple[float, float] = (0.0, 0.0)
    """Of the clearing, horizontally, to where it began."""
    back_to: Phase = Phase.IDLE
    operator_level: Level = Level.OK
    why: str = ""


class Decision(NamedTuple):
    """What is published of it."""

    permit: Permit
    goal: Array
    speed_mps: float
    tare: bool


def step(state: PhaseState, seen: Seen, dt: float, plan: Plan, p: Times) -> tuple[PhaseState, Decision]:
    """One tick: operator's wish and level first, then the phase's own transition, then the permit that follows from both."""
    state = _operator(state, seen)._replace(away_s=0.0 if seen.held else state.away_s + dt)
    after = _escalate(state, seen) or _PHASES[state.phase](state, seen, dt, plan, p)
    after = after._replace(in_phase_s=after.in_phase_s + dt if after.phase is state.phase else 0.0)
    return after, _decide(after, seen, plan, p)


def _enter(state: PhaseState, phase: Phase, why: str = "") -> PhaseState:
    return state._replace(phase=phase, timer_s=0.0, leg=0, back_to=state.phase, why=why)


def _waited(state: PhaseState, condition: bool, dt: float) -> PhaseState:
    return state._replace(timer_s=state.timer_s + dt if condition else 0.0)


def _settled(state: PhaseState, goal: Array, seen: Seen, dt: float, p: Times) -> PhaseState:
    far = float(np.sqrt(np.sum((goal - seen.p_R) ** 2))) > p.settle_m
    fast = float(np.sqrt(np.sum(seen.v_R**2))) > p.settle_mps
    return _waited(state, not far and not fast, dt)


def _operator(state: PhaseState, seen: Seen) -> PhaseState:
    """A command only raises the level, except `resume`, which gives it back."""
    if seen.action is Action.RESUME and state.operator_level < Level.LAND:
        return state._replace(operator_level=Level.OK)
    asked = RAISES.get(seen.action, Level.OK) if seen.action else Level.OK
    return state._replace(operator_level=max(state.operator_level, asked))


AIRBORNE = (Phase.TAKEOFF, Phase.ZEROING, Phase.READY, Phase.GUIDING, Phase.ARRIVED, Phase.CLEARING, Phase.HOLD)


def _escalate(state: PhaseState, seen: Seen) -> PhaseState | None:
    """What a level does to the phase, or None where the phase goes its own way."""
    level = max(seen.level, state.operator_level)
    asked = state.operator_level >= Level.KILL or state.phase not in (Phase.IDLE, Phase.LANDED)
    if level >= Level.KILL and asked and state.phase is not Phase.KILLED:
        return _enter(state._replace(operator_level=Level.KILL), Phase.KILLED, "motors off")
    if state.phase not in AIRBORNE:
        return None
    if level >= Level.DESCEND:
        return _enter(state, Phase.LANDING, "descend")
    if level >= Level.LAND:
        return None if state.phase is Phase.CLEARING else _enter(state, Phase.CLEARING, "asked to land")
    if level >= Level.HOLD and state.phase is not Phase.HOLD:
        return _enter(state, Phase.HOLD, "hold")
    return None


def _idle(state: PhaseState, seen: Seen, dt: float, plan: Plan, p: Times) -> PhaseState:
    if seen.armed:  # begun anew in flight: nothing is known of what was before
        begun = _enter(
            state, Phase.HOLD, "the supervisor began in flight: clew land, or clew resume to fly aside and land"
        )
        return begun._replace(back_to=Phase.CLEARING)
    ready = seen.action is Action.START and seen.level <= Level.WARN
    return _enter(state._replace(operator_level=Level.OK), Phase.TAKEOFF) if ready else state


def _takeoff(state: PhaseState, seen: Seen, dt: float, plan: Plan, p: Times) -> PhaseState:
    state = _settled(state, plan.start, seen, dt, p)
    if state.timer_s >= p.settle_s:
        return _enter(state, Phase.ZEROING)
    return _enter(state, Phase.LANDING, "take-off took too long") if state.in_phase_s > p.takeoff_limit_s else state


def _zeroing(state: PhaseState, seen: Seen, dt: float, plan: Plan, p: Times) -> PhaseState:
    if seen.tare is Tare.PASSED and state.in_phase_s > 0.5:
        return _enter(state, Phase.READY)
    if seen.tare is Tare.FAILED:
        return _enter(state, Phase.CLEARING, "zeroing failed")
    return _enter(state, Phase.CLEARING, "zeroing took too long") if state.in_phase_s > p.takeoff_limit_s else state


def _ready(state: PhaseState, seen: Seen, dt: float, plan: Plan, p: Times) -> PhaseState:
    state = _waited(state, seen.held, dt)
    if state.timer_s >= p.held_s and seen.level < Level.EASE:
        return _enter(state, Phase.GUIDING)
    return _enter(state, Phase.CLEARING, "nobody took the handle") if state.in_phase_s > p.ready_limit_s else state


def _guiding(state: PhaseState, seen: Seen, dt: float, plan: Plan, p: Times) -> PhaseState:
    state = _waited(state, seen.held and seen.end_distance_m < p.arrived_m, dt)
    if state.timer_s >= p.arrived_s:
        return _enter(state, Phase.ARRIVED)
    return _enter(state, Phase.CLEARING, "the handle was let go") if state.away_s >= p.regrasp_s else state


def _arrived(state: PhaseState, seen: Seen, dt: float, plan: Plan, p: Times) -> PhaseState:
    return _enter(state, Phase.CLEARING) if state.away_s >= p.released_s else state


def _clearing(state: PhaseState, seen: Seen, dt: float, plan: Plan, p: Times) -> PhaseState:
    if seen.armed is False:  # nothing flies, nothing is to be cleared
        return _enter(state, Phase.LANDING)
    if state.leg == 0:
        return _set_out(state, seen, plan) if state.in_phase_s >= p.step_back_s else state
    if state.in_phase_s > p.clearing_limit_s:
        return _enter(state, Phase.LANDING, "clearing took too long")
    far = float(np.sqrt(np.sum((_leg(state, plan) - seen.p_R) ** 2))) > 2.0 * p.settle_m
    if far:
        return state
    done = state.leg == len(plan.clearing)
    return _enter(state, Phase.LANDING) if done else state._replace(leg=state.leg + 1)


def _set_out(state: PhaseState, seen: Seen, plan: Plan) -> PhaseState:
    """Begin the route from here, beside the handle, and not from the end of the path."""
    x, y = (seen.p_R - plan.hall.end).tolist()[:2] if plan.hall else (0.0, 0.0)
    return state._replace(leg=1, shift_m=(x, y))


def _leg(state: PhaseState, plan: Plan) -> Array:
    """Where the present leg of the clearing goes."""
    goal = plan.clearing[state.leg - 1] + np.array([*state.shift_m, 0.0])
    return np.clip(goal, plan.hall.low, plan.hall.high) if plan.hall else goal


def _landing(state: PhaseState, seen: Seen, dt: float, plan: Plan, p: Times) -> PhaseState:
    return _enter(state, Phase.LANDED) if seen.armed is False else state


def _hold(state: PhaseState, seen: Seen, dt: float, plan: Plan, p: Times) -> PhaseState:
    if seen.armed is False:  # it has come down meanwhile
        return _enter(state, Phase.LANDING)
    clear = max(seen.level, state.operator_level) < Level.EASE and seen.action is Action.RESUME
    return _enter(state, state.back_to) if clear else state


def _stay(state: PhaseState, seen: Seen, dt: float, plan: Plan, p: Times) -> PhaseState:
    return state


_PHASES = {
    Phase.IDLE: _idle,
    Phase.TAKEOFF: _takeoff,
    Phase.ZEROING: _zeroing,
    Phase.READY: _ready,
    Phase.GUIDING: _guiding,
    Phase.ARRIVED: _arrived,
    Phase.CLEARING: _clearing,
    Phase.LANDING: _landing,
    Phase.LANDED: _stay,
    Phase.HOLD: _hold,
    Phase.KILLED: _stay,
}

_PERMITS = {
    Phase.IDLE: Permit.NONE,
    Phase.TAKEOFF: Permit.POSITION,
    Phase.ZEROING: Permit.POSITION,
    Phase.READY: Permit.WAIT,
    Phase.GUIDING: Permit.GUIDE,
    Phase.ARRIVED: Permit.GUIDE,
    Phase.CLEARING: Permit.POSITION,
    Phase.LANDING: Permit.LAND,
    Phase.LANDED: Permit.NONE,
    Phase.HOLD: Permit.HOLD,
    Phase.KILLED: Permit.KILL,
}


def _decide(state: PhaseState, seen: Seen, plan: Plan, p: Times) -> Decision:
    permit = _PERMITS[state.phase]
    if permit in (Permit.WAIT, Permit.GUIDE) and max(seen.level, state.operator_level) >= Level.EASE:
        permit = Permit.EASE
    if state.phase is Phase.CLEARING:
        if state.leg == 0:  # stand still, compliant, while the person steps back
            return Decision(Permit.EASE, seen.p_R, p.slow_mps, False)
        return Decision(permit, _leg(state, plan), p.slow_mps, False)
    return Decision(permit, plan.start, p.fast_mps, state.phase is Phase.ZEROING)
