"""The supervisor's rules: one table of conditions, each with its debounce, level, text for the operator and cure.

A rule becomes active when its condition has held for `debounce_s`. Up to EASE it goes back by itself once the condition
has been gone for `release_s`; HOLD and above stay until a person confirms (`resume`) with the cause gone. The state is
one pair of timers per rule; nothing here knows a clock.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from schemas.safety import Level, Phase
from services.parameters import Positive, parameters
from services.safety_supervisor import lag

FLYING = frozenset(Phase) - {Phase.IDLE, Phase.LANDED, Phase.KILLED}
ALOFT = FLYING - {Phase.LANDING}
ENGAGED = frozenset({Phase.READY, Phase.GUIDING, Phase.ARRIVED})
PREPARED = ENGAGED | {Phase.IDLE}  # on the ground these keep the vehicle from starting
PULLING = frozenset({Phase.GUIDING, Phase.ARRIVED})

CABLE_SHORT_M = 0.08  # less than what lets the hanging handle push the vehicle ahead as a hand would


@parameters
class Limits:
    """What the rules compare with."""

    hand_force_ease_N: Positive
    hand_force_hold_N: Positive
    head_warn_m: Positive
    """Rotor tip to the head, which is assumed to be behind the hand (G10)."""
    head_ease_m: Positive
    hand_clearance_m: Positive
    """Vehicle's centre to hand."""
    force_aside_N: Positive
    """Across the cable; what the estimate errs by when the vehicle is pulled about is less."""
    bias_warn_N: Positive
    bias_hold_N: Positive
    energy_created_warn_J: Positive
    """By the filter out of nothing; its books close to rounding, so this is far above any error (energy.py)."""
    age_ease_s: Positive
    age_hold_s: Positive
    robot_apart_m: Positive
    robot_lost_s: Positive
    """The autopilot goes on by dead reckoning, for about twice as long."""
    stall_s: Positive
    """A loop later than this means that the host took the processor away."""
    battery_warn_fraction: Positive
    battery_land_fraction: Positive
    release_s: Positive
    clock_uncertainty_max_s: Positive
    """Of the comparison of the two hosts' clocks: what it adds to the age of a command."""
    time_of_day_apart_max_s: Positive


class Facts(NamedTuple):
    """What the supervisor knows at one tick; ages are infinite where nothing has arrived."""

    handle_age_s: float
    robot_pose_age_s: float
    """Of what motion capture says; the autopilot's own position goes on without it, and drifts."""
    robot_apart_m: float
    """Between motion capture and the autopilot, about where the vehicle is."""
    vehicle_age_s: float
    force_age_s: float
    guidance_age_s: float
    setpoint_age_s: float
    force_aside_N: float
    """Part of f̂_c across a taut cable; 0 where that is not seen."""
    offboard: bool
    autopilot_lands: bool
    hand_force_N: float
    head_clearance_m: float
    hand_clearance_m: float
    robot_outside_m: float
    """How far the robot is outside the volume; negative inside."""
    above_ceiling_m: float
    """How far the robot is above hand plane + l̄ + margin; negative below."""
    bias_change_N: float
    energy_created_J: float
    tank_scale: float
    """Part of the guiding force that the energy tank lets act."""
    battery_fraction: float
    stall_s: float
    clock_uncertainty_s: float = 0.0
    """Infinite before the first comparison; 0 on one host."""
    time_of_day_apart_s: float = 0.0
    loop_lag_s: float = 0.0
    """From the force that is felt to the set-point that follows it, on average."""
    killed: bool = False
    """The pilot's kill switch is on, so says the autopilot."""
    cable_short_m: float = 0.0
    """How much nearer to the vehicle the handle is seen than the cable is long."""
    cable_caught_m: float = 0.0
    """The same where it carries the handle, which then is in nobody's hand (caught.py)."""


@dataclass(frozen=True)
class Rule:
    """One line of the table."""

    name: str
    broken: Callable[[Facts, Limits], bool]
    phases: frozenset[Phase]
    debounce_s: float
    level: Level
    text: str
    cure: str


# fmt: off
RULES: tuple[Rule, ...] = (
    #    name                 broken when                                          in       debounce level       text                                       cure
    Rule("pilot_killed",      lambda f, p: f.killed,                                FLYING | {Phase.IDLE, Phase.KILLED}, 0.0, Level.KILL, "the pilot's kill switch is on", "switch it back with nobody near: until then nothing arms"),
    Rule("vehicle_silent",    lambda f, p: f.vehicle_age_s > p.age_ease_s,          FLYING | {Phase.IDLE}, 0.0, Level.EASE, "the vehicle's state is stale",             "check the link between bridge and autopilot"),
    Rule("vehicle_lost",      lambda f, p: f.vehicle_age_s > p.age_hold_s,          FLYING,  0.0, Level.DESCEND, "the vehicle has long been silent",        "let go, step back: the autopilot lands by itself"),
    Rule("autopilot_lands",   lambda f, p: f.autopilot_lands,                       ALOFT,   0.1, Level.DESCEND, "the autopilot lands by itself",           "let go, step back"),
    Rule("handle_hidden",     lambda f, p: f.handle_age_s > p.age_ease_s,           PREPARED, 0.0, Level.EASE,  "the handle is not seen",                   "check its markers and the capture system"),
    Rule("handle_lost",       lambda f, p: f.handle_age_s > p.age_hold_s,           ENGAGED, 2.0, Level.HOLD,  "the handle has not been seen for long",    "check its markers and the capture system"),
    Rule("robot_hidden",      lambda f, p: f.robot_pose_age_s > p.age_hold_s,       PREPARED, 0.5, Level.EASE, "the vehicle is not seen",                  "check its markers and the capture system"),
    Rule("robot_lost",        lambda f, p: f.robot_pose_age_s > p.robot_lost_s,     FLYING,  0.0, Level.DESCEND, "the autopilot flies without motion capture", "let go, step back: it lands"),
    Rule("robot_elsewhere",   lambda f, p: f.robot_apart_m > p.robot_apart_m,       ALOFT | {Phase.IDLE}, 0.1, Level.EASE,  "motion capture sees the vehicle elsewhere", "check the markers of vehicle and handle"),
    Rule("robot_gone",        lambda f, p: f.robot_apart_m > p.robot_apart_m,       ALOFT,   2.0, Level.DESCEND, "motion capture has long seen the vehicle elsewhere", "let go, step back: it lands"),
    Rule("force_silent",      lambda f, p: f.force_age_s > p.age_ease_s,            PREPARED, 0.0, Level.EASE,  "the force estimate is stale",              "check force_estimator and the IMU stream"),
    Rule("force_aside",       lambda f, p: f.force_aside_N > p.force_aside_N,       ENGAGED, 0.1, Level.HOLD,  "the force does not point along the cable", "check force_estimator and the frames"),
    Rule("guidance_silent",   lambda f, p: f.guidance_age_s > p.age_ease_s,         PULLING, 0.0, Level.EASE,  "guidance is stale",                        "check guiding_controller and the radio"),
    Rule("setpoints_silent",  lambda f, p: f.setpoint_age_s > p.age_ease_s,         ENGAGED, 0.0, Level.EASE,  "no set-points leave the bridge",           "check px4_bridge"),
    Rule("not_offboard",      lambda f, p: not f.offboard,                          ENGAGED, 0.3, Level.HOLD,  "the autopilot left offboard mode",         "read the autopilot's messages"),
    Rule("pull_strong",       lambda f, p: f.hand_force_N > p.hand_force_ease_N,    ENGAGED, 0.1, Level.EASE,  "the pull on the hand is too strong",       "let the person come closer"),
    Rule("pull_dangerous",    lambda f, p: f.hand_force_N > p.hand_force_hold_N,    ENGAGED, 0.05, Level.HOLD, "the pull on the hand is dangerous",        "release the handle"),
    Rule("head_near",         lambda f, p: f.head_clearance_m < p.head_warn_m,      ENGAGED, 0.3, Level.WARN,  "a propeller is within reach of the head",  "stretch the arm, step back"),
    Rule("head_too_near",     lambda f, p: f.head_clearance_m < p.head_ease_m,      ENGAGED, 0.1, Level.EASE,  "a propeller is near the head",             "step back from under the vehicle"),
    Rule("hand_near",         lambda f, p: f.hand_clearance_m < p.hand_clearance_m, ENGAGED, 0.1, Level.EASE,  "the vehicle is near the hand",             "lower the hand"),
    Rule("ceiling",           lambda f, p: f.above_ceiling_m > 0.0,                 ENGAGED, 0.2, Level.EASE,  "the vehicle is above its ceiling",         "none: it comes down by itself"),
    Rule("outside",           lambda f, p: f.robot_outside_m > 0.0,                 FLYING,  0.1, Level.HOLD,  "the vehicle left the volume",              "guide it back or land"),
    Rule("bias_moving",       lambda f, p: f.bias_change_N > p.bias_warn_N,         ENGAGED, 0.5, Level.WARN,  "the force bias has moved since zeroing",   "zero again soon"),
    Rule("bias_moved",        lambda f, p: f.bias_change_N > p.bias_hold_N,         ENGAGED, 0.5, Level.HOLD,  "the force estimate cannot be trusted",     "land and zero again"),
    Rule("energy_created",    lambda f, p: f.energy_created_J > p.energy_created_warn_J, ENGAGED, 0.0, Level.WARN, "the filter made energy out of nothing",  "land, and keep the recording"),
    Rule("tank_empty",        lambda f, p: f.tank_scale < 1.0,                      PULLING, 0.0, Level.WARN,  "guidance has used up its energy",          "land; the next start fills the tank"),
    Rule("battery_low",       lambda f, p: f.battery_fraction < p.battery_warn_fraction, FLYING, 2.0, Level.WARN, "the battery is low",                   "finish soon"),
    Rule("battery_empty",     lambda f, p: f.battery_fraction < p.battery_land_fraction, FLYING, 2.0, Level.LAND, "the battery is empty",                 "change it"),
    Rule("clocks_unknown",    lambda f, p: f.clock_uncertainty_s > p.clock_uncertainty_max_s, PREPARED, 0.0, Level.EASE, "the clocks of the two hosts are not compared", "look at clew link"),
    Rule("time_of_day",       lambda f, p: f.time_of_day_apart_s > p.time_of_day_apart_max_s, PREPARED, 0.0, Level.EASE, "the two hosts differ in the time of day", "set up chrony (docs/operate.md)"),
    Rule("loop_late",         lambda f, p: f.loop_lag_s > lag.LATE_S,               ENGAGED, 0.0, Level.EASE,  "the force is flown too late",              "stop what else runs on the drone's host"),
    Rule("cable_short",       lambda f, p: f.cable_short_m > CABLE_SHORT_M,         frozenset({Phase.ZEROING}), 0.5, Level.LAND, "the handle hangs higher than the cable is long", "untangle the cable, or mend rest_length_m"),
    Rule("cable_caught",      lambda f, p: f.cable_caught_m > CABLE_SHORT_M,        frozenset({Phase.READY}), 0.2, Level.LAND, "the cable is caught: the handle hangs high",   "keep off the handle; untangle the cable"),
    Rule("host_stall",        lambda f, p: f.stall_s > p.stall_s,                   ENGAGED, 0.0, Level.EASE,  "this host took the processor away",        "stop what else runs on it"),
)
# fmt: on


class RuleState(NamedTuple):
    """Per rule, in the table's order: seconds broken, seconds since it was last broken, active or not."""

    broken_s: np.ndarray
    clear_s: np.ndarray
    active: np.ndarray


def initial(rules: Sequence[Rule] = RULES) -> RuleState:
    """Nothing broken, nothing active."""
    n = len(rules)
    return RuleState(np.zeros(n), np.zeros(n), np.zeros(n, dtype=bool))


def step(
    state: RuleState,
    facts: Facts,
    phase: Phase,
    resume: bool,
    dt: float,
    p: Limits,
    rules: Sequence[Rule] = RULES,
) -> tuple[RuleState, list[Rule]]:
    """One tick; returns the active rules, the gravest first, in the table's order within a level.

    What is active goes on being judged in HOLD: resuming needs its cause gone, not only its phase.
    """
    judged = [phase in r.phases or (phase is Phase.HOLD and on) for r, on in zip(rules, state.active, strict=True)]
    broken = np.array([now and r.broken(facts, p) for r, now in zip(rules, judged, strict=True)])
    debounce = np.array([r.debounce_s for r in rules])
    latched = np.array([r.level >= Level.HOLD for r in rules])
    broken_s = np.where(broken, state.broken_s + dt, 0.0)
    clear_s = np.where(broken, 0.0, state.clear_s + dt)
    released = ~broken & np.where(latched, resume, clear_s >= p.release_s)
    active = (broken & (broken_s >= debounce)) | (state.active & ~released)
    if phase not in FLYING:  # on the ground nothing needs a confirmation
        active &= broken
    named = [r for r, on in zip(rules, active, strict=True) if on]
    return RuleState(broken_s, clear_s, active), sorted(named, key=lambda r: -r.level)
