"""The bridge's law: which set-point follows from permit, guidance and cable force.

Two ways of flying. In POSITION mode the reference walks to the supervisor's goal; in HOLD it stands, the cable slack. In the
three others the admittance filter moves it: anchored over the start (WAIT; once the handle is held it rises until the cable
is taut), guided (GUIDE), or giving way without any pull (EASE). The change between them is bumpless: each starts from the last
reference sent, and the fed-forward cable force is ramped (G9). Without a fresh cable force the filter cannot fly: then EASE
stands like HOLD. Both let the cable hang slack and go along with a hand that walks on; all keep away from one that comes near
(leash.py). All that guidance puts into the filter is paid for from a tank (tank.py), and the books of the filter's ports are
kept (energy.py); neither says anything of position mode.

| paper | here | unit | frame |
|---|---|---|---|
| f̂_c | Force.f_c | N | W |
| p_R^d(s*), f^d(s*) | Guidance.p_R_d, f_d | m, N | W |
| m_R | m_R_kg | kg | |
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from schemas.safety import Permit
from schemas.vehicle import SetpointKind
from services.parameters import NonNegative, Positive, parameters
from services.physics import Array, Row, Z, norm
from services.px4_bridge import admittance, approach, energy, leash, tank
from services.px4_bridge import setpoint as setpoints
from services.px4_bridge.admittance import Admittance, Command
from services.px4_bridge.approach import Approach
from services.px4_bridge.energy import Balance
from services.px4_bridge.leash import Hand
from services.px4_bridge.setpoint import Limits, Setpoint
from services.px4_bridge.tank import Tank

SLACK = (SetpointKind.EASE, SetpointKind.HOLD)  # how the system backs off
SLACK_N = 1.5  # a cable that pulls harder is taut, whatever the estimate errs by while the vehicle accelerates
MEAN_S = 0.2
BELIEF_N = 2.5  # harder than it is ever asked to pull: the hand is not where it is seen, or the cable is caught


@parameters
class Flight:
    """What the bridge needs to know to fly."""

    m_R_kg: Positive
    handle_weight_N: NonNegative
    rest_length_m: Positive
    ceiling_m: Positive
    """Height above the floor that the reference never rises beyond while a person may be on the cable (G6)."""
    feed_forward_ramp_s: Positive
    feed_forward_drop_s: Positive
    """Where it stands with the cable slack, or without a fresh force."""
    lead_s: NonNegative
    """How much later than its set-point the vehicle's horizontal acceleration comes."""
    ease_slack_m: Positive
    """How far inside its rest length the cable hangs when the system has backed off."""
    hand_clear_m: Positive
    """Vehicle's centre to hand: nearer than this, the hand pushes the vehicle ahead of it."""
    follow_mps: Positive
    """At most as fast as this it goes along with a person while it holds."""
    yaw_rad: float
    """Heading that the vehicle keeps, from x, anticlockwise."""


_UNDAMPED = (0.0, 0.0, 0.0)


class Params(NamedTuple):
    """All of the law's parameters."""

    flight: Flight
    admittance: Admittance
    approach: Approach
    limits: Limits
    tank: Tank


class Force(NamedTuple):
    """One sample of the estimator: f̂_c (3,) N, slack by motion capture, and the time since the sample before."""

    f_c: Array
    slack: bool
    dt_s: float


class Guidance(NamedTuple):
    """What the ground asks for, while it is fresh."""

    p_R_d: Array
    f_d: Array
    scale: float


class Input(NamedTuple):
    """One tick. `forces` is empty where no sample came in time; `force_fresh` says whether the newest can be trusted."""

    permit: Permit
    goal: Array
    speed_mps: float
    held: bool
    forces: Sequence[Force]
    force_fresh: bool
    guidance: Guidance | None
    hand: Hand | None = None
    """The hand, where motion capture sees the handle; None where it is only guessed."""


class Port(NamedTuple):
    """What the filter's ports have passed, what guidance may still spend, and B_A by axes in N s/m (0: no filter)."""

    tank: tank.State
    balance: Balance
    damping: Row


class State(NamedTuple):
    """The filter is the reference in every mode; `hold` is where height is kept while nobody holds the handle.

    `f_mean` is f̂_c over the last MEAN_S: what is decided once does not go by one sample.
    """

    kind: SetpointKind
    filter: admittance.State
    p_sent: Array
    f_hat: Array
    f_mean: Array
    feed_forward: float
    hold: Array
    u_A: Array
    port: Port


class Output(NamedTuple):
    """The set-point and what is behind it."""

    kind: SetpointKind
    sent: Setpoint
    u_R: Array
    u_A: Array
    feed_forward: float


def initial(p_R: Array, p: Params) -> State:
    """On the ground or in the air, at rest at `p_R` (3,) m."""
    port, zero = Port(tank.charged(p.tank), Balance(), _UNDAMPED), np.zeros(3)
    return State(SetpointKind.NONE, admittance.engage(p_R), p_R, zero, zero, 0.0, p_R, zero, port)


def step(state: State, x: Input, dt: float, p: Params) -> tuple[State, Output]:
    """One tick of `dt` s: advance the reference, then make the set-point of it."""
    kind = _kind(x)
    if kind is not state.kind:
        state = _change(state, kind, p)
    eased = kind is SetpointKind.EASE and not _sees(state, x)
    complies = x.force_fresh and (kind is SetpointKind.ADMITTANCE or eased)
    if kind in SLACK:
        state = state._replace(hold=_slackened(state.hold, x, p))
    state = _filter(state, x, p) if complies else _without_filter(state, x, dt, p)
    state = state._replace(f_mean=_mean(state, x), feed_forward=_fed_forward(state, complies, dt, p.flight))
    reference = setpoints.ahead(state.filter, state.port.damping, p.admittance.M_A_kg, p.flight.lead_s)
    sent = setpoints.setpoint(reference, state.f_hat, p.flight.m_R_kg, state.feed_forward, state.p_sent, p.limits)
    state = state._replace(p_sent=sent.p)
    return state, Output(kind, sent, state.filter.a, state.u_A, state.feed_forward)


def _mean(state: State, x: Input) -> Array:
    f_mean = state.f_mean
    for force in x.forces:
        f_mean = f_mean + min(force.dt_s / MEAN_S, 1.0) * (force.f_c - f_mean)
    return f_mean


def _fed_forward(state: State, complies: bool, dt: float, p: Flight) -> float:
    """Its share goes quickly where the cable is to go slack: what is fed forward of a force that is gone pushes ahead."""
    fade_s = p.feed_forward_drop_s if state.kind in SLACK else p.feed_forward_ramp_s
    change = dt / p.feed_forward_ramp_s if complies else -dt / fade_s
    return min(max(state.feed_forward + change, 0.0), 1.0)


def _kind(x: Input) -> SetpointKind:
    if x.permit is Permit.HOLD:
        return SetpointKind.HOLD
    if x.permit is Permit.EASE or (x.permit in (Permit.WAIT, Permit.GUIDE) and not x.force_fresh):
        return SetpointKind.EASE
    if x.permit is Permit.GUIDE and x.held and x.guidance is None:
        return SetpointKind.EASE
    return SetpointKind.ADMITTANCE if x.permit in (Permit.WAIT, Permit.GUIDE) else SetpointKind.POSITION


def _change(state: State, kind: SetpointKind, p: Params) -> State:
    """The new way of flying begins at the reference that was flown last; engaged from position mode, with a full tank."""
    reference, port = state.filter, state.port
    if kind is SetpointKind.ADMITTANCE and state.kind in (SetpointKind.POSITION, SetpointKind.NONE):
        reference, port = admittance.engage(reference.p), port._replace(tank=tank.charged(p.tank))
    hold = reference.p
    if kind in SLACK:  # from one of them to the other the cable is slack already
        hold = state.hold if state.kind in SLACK else hold - _slackening(state, p)
    return state._replace(kind=kind, filter=reference, hold=hold, port=port)


def _slackening(state: State, p: Params) -> Array:
    """From here towards the hand along a taut cable, which does not just hang, until it is slack, (3,) m."""
    pull = float(norm(state.f_mean))
    taut = pull > 2.0 * p.flight.handle_weight_N + 0.1
    return p.flight.ease_slack_m * state.f_mean / pull if taut else np.zeros(3)


def _slackened(hold: Array, x: Input, p: Params) -> Array:
    """Where to stand so that the cable in the person's hand stays slack, and the hand clear of the propellers."""
    if x.hand is None or not x.held:
        return hold
    return leash.between(hold, x.hand.p, p.flight.hand_clear_m, p.flight.rest_length_m - p.flight.ease_slack_m)


def _may_be_near(state: State, x: Input) -> bool:
    """Near the hand the cable hangs slack: where it pulls, the hand is seen where it is not."""
    return not x.force_fresh or float(norm(state.f_hat)) < SLACK_N


def _sees(state: State, x: Input) -> bool:
    """Whether the capture system shows the hand that holds, and the cable does not contradict it."""
    return x.hand is not None and x.held and float(norm(state.f_hat)) < BELIEF_N


def _kept_clear(state: State, x: Input, dt: float, p: Params) -> State:
    """Where no filter moves it, a hand that comes near pushes the reference, and one that does not let go leads it."""
    if x.hand is None or (state.kind is SetpointKind.POSITION and not x.held):
        return state
    at = state.filter
    if _may_be_near(state, x):
        position, velocity = leash.pushed(at.p, at.v, x.hand, dt, p.flight.hand_clear_m)
        at = at._replace(p=position, v=velocity)
    if x.held:
        far_m = p.flight.rest_length_m - p.flight.ease_slack_m
        position, velocity = leash.led(at.p, at.v, x.hand, dt, far_m)
        at = at._replace(p=position, v=velocity)
    return state._replace(filter=at)


def _without_filter(state: State, x: Input, dt: float, p: Params) -> State:
    """To the goal, or where it stands, clear of the hand; the books know that no filter did it."""
    state = _kept_clear(_approach(_felt_now(state, x), x, dt, p), x, dt, p)
    balance = energy.hand_over(state.port.balance, energy.kinetic(state.filter.v, p.admittance.M_A_kg))
    return state._replace(port=state.port._replace(balance=balance, damping=_UNDAMPED))


def _approach(state: State, x: Input, dt: float, p: Params) -> State:
    """Position mode, or a standstill where the filter is not to be asked or has nothing to go by."""
    goal, speed = (x.goal, x.speed_mps) if x.permit is Permit.POSITION else (state.hold, p.flight.follow_mps)
    at, a = approach.step(approach.State(state.filter.p, state.filter.v), goal, speed, dt, p.approach)
    if state.kind in SLACK:  # led and pushed as well: what the approach brakes of that is no acceleration of its own
        a = np.zeros(3)
    moved = state.filter._replace(p=at.p, v=at.v, a=a)
    hold = at.p if x.permit is Permit.POSITION else state.hold
    return state._replace(filter=moved, u_A=np.zeros(3), hold=hold)


def _filter(state: State, x: Input, p: Params) -> State:
    """The admittance filter behind its tank, once for each force sample since the last tick."""
    command, hold = _command(state, x, p)
    reference, u_A, f_hat = state.filter, state.u_A, state.f_hat
    left, balance = state.port.tank, state.port.balance
    for force in x.forces:
        f_hat = force.f_c
        push, z_max_m = _pushed(state._replace(filter=reference, f_hat=f_hat), x, p.flight)
        left, moved, u_A, through = tank.step(
            left, reference, f_hat - push, command, force.slack, force.dt_s, z_max_m, p.admittance, p.tank
        )
        through = energy.apart(through, push, reference.p, moved.p)
        balance = energy.add(balance, through, energy.kinetic(moved.v, p.admittance.M_A_kg))
        reference = moved
    port = Port(left, balance, admittance.damping(reference, command, p.admittance))
    return state._replace(filter=reference, u_A=u_A, f_hat=f_hat, hold=hold, port=port)


def _felt_now(state: State, x: Input) -> State:
    """What the cable does is followed where no filter runs on it, too."""
    return state._replace(f_hat=x.forces[-1].f_c) if x.forces else state


def _pushed(state: State, x: Input, p: Flight) -> tuple[Array, float]:
    """The push of a hand that is near on the filter, (3,) N, and the ceiling that it leaves."""
    if x.hand is None or not _may_be_near(state, x):
        return np.zeros(3), p.ceiling_m
    push = leash.push(state.filter.p, state.filter.v, x.hand, p.hand_clear_m)
    return push, max(p.ceiling_m, float(x.hand.p[2]) + p.hand_clear_m)


def _command(state: State, x: Input, p: Params) -> tuple[Command, Array]:
    """What the filter is asked for, and where height would be held if the handle were let go now."""
    if x.permit is Permit.WAIT and x.held and x.guidance is not None:  # taken: rise until the cable is taut
        return admittance.guide(x.goal, x.guidance.f_d * Z, 1.0, p.admittance), state.filter.p
    if x.permit is Permit.WAIT:
        return admittance.wait(x.goal, p.flight.handle_weight_N, p.admittance), state.filter.p
    if state.kind is SetpointKind.EASE:
        command = admittance.ease(state.hold, p.admittance, anchored=x.hand is not None)
        return (command if x.held else command._replace(f_d=p.flight.handle_weight_N * Z)), state.hold  # it hangs
    if x.held and x.guidance is not None:
        return admittance.guide(x.guidance.p_R_d, x.guidance.f_d, x.guidance.scale, p.admittance), state.filter.p
    return admittance.hold_height(state.hold, p.flight.handle_weight_N, p.admittance), state.hold
