"""The table of rules: each fires by its own condition, in its own phases, after its own time, and goes back as it should."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.safety import Level, Phase
from services.safety_supervisor import rules
from services.safety_supervisor.rules import ENGAGED, FLYING, RULES, Facts, Limits, Rule

P = Limits(
    hand_force_ease_N=3.5,
    hand_force_hold_N=6.0,
    head_warn_m=0.5,
    head_ease_m=0.4,
    hand_clearance_m=0.6,
    force_aside_N=1.0,
    bias_warn_N=0.3,
    bias_hold_N=0.6,
    energy_created_warn_J=1e-6,
    age_ease_s=0.2,
    age_hold_s=1.0,
    robot_apart_m=0.3,
    robot_lost_s=2.5,
    stall_s=0.1,
    battery_warn_fraction=0.3,
    battery_land_fraction=0.15,
    release_s=0.8,
    clock_uncertainty_max_s=0.05,
    time_of_day_apart_max_s=1.0,
)
FINE = Facts(
    handle_age_s=0.0,
    robot_pose_age_s=0.0,
    vehicle_age_s=0.0,
    force_age_s=0.0,
    guidance_age_s=0.0,
    setpoint_age_s=0.0,
    force_aside_N=0.0,
    robot_apart_m=0.0,
    offboard=True,
    autopilot_lands=False,
    hand_force_N=0.0,
    head_clearance_m=np.inf,
    hand_clearance_m=np.inf,
    robot_outside_m=-1.0,
    above_ceiling_m=-0.5,
    bias_change_N=0.0,
    energy_created_J=0.0,
    tank_scale=1.0,
    battery_fraction=1.0,
    stall_s=0.0,
)
WORST = Facts(
    9.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0, False, True, 9.0, 0.0, 0.0, 1.0, 1.0, 9.0, 9.0, 0.0, 0.0, 9.0, 9.0, 9.0, 9.0
)._replace(killed=True)
DT = 0.05
NAMES = {rule.name: rule for rule in RULES}
# One value on either side of each limit: what breaks exactly this rule (and those that a graver case of it implies).
CASES: dict[str, tuple[str, object, object, set[str]]] = {
    "clocks_unknown": ("clock_uncertainty_s", 0.049, 0.051, set()),
    "time_of_day": ("time_of_day_apart_s", 0.99, 1.01, set()),
    "vehicle_silent": ("vehicle_age_s", 0.19, 0.21, set()),
    "vehicle_lost": ("vehicle_age_s", 0.99, 1.01, {"vehicle_silent"}),
    "robot_elsewhere": ("robot_apart_m", 0.29, 0.31, {"robot_gone"}),
    "robot_gone": ("robot_apart_m", 0.29, 0.31, {"robot_elsewhere"}),
    "autopilot_lands": ("autopilot_lands", False, True, set()),
    "handle_hidden": ("handle_age_s", 0.19, 0.21, set()),
    "handle_lost": ("handle_age_s", 0.99, 1.01, {"handle_hidden"}),
    "robot_hidden": ("robot_pose_age_s", 0.99, 1.01, set()),
    "robot_lost": ("robot_pose_age_s", 2.49, 2.51, {"robot_hidden"}),
    "force_silent": ("force_age_s", 0.19, 0.21, set()),
    "force_aside": ("force_aside_N", 0.99, 1.01, set()),
    "guidance_silent": ("guidance_age_s", 0.19, 0.21, set()),
    "setpoints_silent": ("setpoint_age_s", 0.19, 0.21, set()),
    "not_offboard": ("offboard", True, False, set()),
    "pull_strong": ("hand_force_N", 3.49, 3.51, set()),
    "pull_dangerous": ("hand_force_N", 5.99, 6.01, {"pull_strong"}),
    "head_near": ("head_clearance_m", 0.51, 0.49, set()),
    "head_too_near": ("head_clearance_m", 0.41, 0.39, {"head_near"}),
    "hand_near": ("hand_clearance_m", 0.61, 0.59, set()),
    "ceiling": ("above_ceiling_m", -0.01, 0.01, set()),
    "outside": ("robot_outside_m", -0.01, 0.01, set()),
    "bias_moving": ("bias_change_N", 0.29, 0.31, set()),
    "bias_moved": ("bias_change_N", 0.59, 0.61, {"bias_moving"}),
    "energy_created": ("energy_created_J", 0.9e-6, 1.1e-6, set()),
    "tank_empty": ("tank_scale", 1.0, 0.99, set()),
    "battery_low": ("battery_fraction", 0.31, 0.29, set()),
    "battery_empty": ("battery_fraction", 0.16, 0.14, {"battery_low"}),
    "loop_late": ("loop_lag_s", 0.039, 0.041, set()),
    "pilot_killed": ("killed", False, True, set()),
    "cable_short": ("cable_short_m", 0.079, 0.081, set()),
    "cable_caught": ("cable_caught_m", 0.079, 0.081, set()),
    "host_stall": ("stall_s", 0.09, 0.11, set()),
}
each_rule = pytest.mark.parametrize("name", NAMES)


def broken(name: str) -> Facts:
    field, _, bad, _ = CASES[name]
    return FINE._replace(**{field: bad})


def home(rule: Rule) -> Phase:
    """A flying phase in which the rule counts."""
    return next(p for p in (Phase.GUIDING, Phase.TAKEOFF, Phase.ZEROING, Phase.READY) if p in rule.phases)


def watch(
    facts: Facts, seconds: float, phase: Phase, state: rules.RuleState | None = None, resume: bool = False
) -> tuple[rules.RuleState, list[str]]:
    state, active = state or rules.initial(), []
    for _ in range(round(seconds / DT)):
        state, active = rules.step(state, facts, phase, resume, DT, P)
    return state, [rule.name for rule in active]


def test_each_rule_has_a_case() -> None:
    assert set(CASES) == set(NAMES)
    assert len(NAMES) == len(RULES)


@each_rule
def test_each_rule_tells_the_operator_what_and_what_to_do(name: str) -> None:
    rule = NAMES[name]
    assert len(rule.text.split()) >= 3
    assert rule.cure
    assert rule.level > Level.OK
    assert rule.phases <= set(Phase)


@each_rule
def test_it_fires_by_its_own_condition_and_no_other(name: str) -> None:
    rule, (field, good, _, implied) = NAMES[name], CASES[name]
    phase = home(rule)
    _, active = watch(broken(name), 3.0, phase)
    assert set(active) == {name} | {other for other in implied if phase in NAMES[other].phases}
    _, active = watch(FINE._replace(**{field: good}), 3.0, phase)
    assert name not in active


def test_when_all_is_well_nothing_fires_in_any_phase() -> None:
    assert all(watch(FINE, 3.0, phase)[1] == [] for phase in Phase)


@each_rule
def test_it_counts_in_its_own_phases_only(name: str) -> None:
    fires = {phase for phase in Phase if name in watch(broken(name), 3.0, phase)[1]}
    assert fires == NAMES[name].phases


@each_rule
def test_it_waits_for_its_debounce_and_begins_anew_after_a_good_tick(name: str) -> None:
    rule = NAMES[name]
    phase = home(rule)
    needed = max(round(rule.debounce_s / DT), 1)
    if needed > 1:
        state, active = watch(broken(name), (needed - 1) * DT, phase)
        assert name not in active
        state, _ = watch(FINE, DT, phase, state)
        _, active = watch(broken(name), (needed - 1) * DT, phase, state)
        assert name not in active
    _, active = watch(broken(name), (needed + 1) * DT, phase)
    assert name in active


@each_rule
def test_up_to_ease_it_goes_back_by_itself_and_from_hold_on_it_waits_for_a_person(name: str) -> None:
    rule = NAMES[name]
    phase = home(rule)
    state, active = watch(broken(name), 3.0, phase)
    state, active = watch(FINE, P.release_s - DT, phase, state)
    assert name in active
    state, active = watch(FINE, 3.0, phase, state)
    assert (name in active) == (rule.level >= Level.HOLD)
    _, active = watch(FINE, DT, phase, state, resume=True)
    assert name not in active


@each_rule
def test_a_person_cannot_confirm_away_what_is_still_so(name: str) -> None:
    state, _ = watch(broken(name), 3.0, home(NAMES[name]))
    assert name in watch(broken(name), 1.0, home(NAMES[name]), state, resume=True)[1]


@pytest.mark.parametrize("name", [name for name, rule in NAMES.items() if rule.level is Level.HOLD])
def test_in_hold_the_cause_is_still_judged(name: str) -> None:
    """HOLD is another phase than the one the rule fired in: resuming must not go back into the same trouble."""
    state, _ = watch(broken(name), 3.0, home(NAMES[name]))
    state, active = watch(broken(name), 2.0, Phase.HOLD, state, resume=True)
    assert name in active
    state, active = watch(FINE, 2.0, Phase.HOLD, state)
    assert name in active
    assert watch(FINE, DT, Phase.HOLD, state, resume=True)[1] == []


@each_rule
@pytest.mark.parametrize("ground", [Phase.IDLE, Phase.LANDED])
def test_on_the_ground_nothing_needs_a_confirmation(name: str, ground: Phase) -> None:
    rule = NAMES[name]
    state, _ = watch(broken(name), 3.0, home(rule))
    assert name not in watch(FINE, DT, ground, state)[1]
    state, active = watch(broken(name), 3.0, ground)
    assert (name in active) == (ground in rule.phases)
    assert watch(FINE, DT, ground, state)[1] == []


@pytest.mark.parametrize("phase", sorted(FLYING))
def test_the_gravest_comes_first(phase: Phase) -> None:
    _, active = watch(WORST, 3.0, phase)
    assert active
    levels = [NAMES[name].level for name in active]
    assert all(a >= b for a, b in pairwise(levels))
    order = [rule.name for rule in RULES]
    for (a, level_a), (b, level_b) in pairwise(zip(active, levels, strict=True)):
        assert level_a > level_b or order.index(a) < order.index(b)


def test_everything_is_watched_while_a_person_is_on_the_cable() -> None:
    before = {"cable_short", "cable_caught"}  # while nobody pulls
    assert set(watch(WORST, 3.0, Phase.GUIDING)[1]) == set(NAMES) - before
    assert all(rule.phases & ENGAGED or rule.phases <= FLYING | {Phase.IDLE} for rule in RULES)


AGE, LENGTH = st.floats(0.0, 3.0), st.floats(-1.0, 2.0)
FACTS = st.builds(
    Facts,
    handle_age_s=AGE,
    robot_pose_age_s=AGE,
    vehicle_age_s=AGE,
    force_age_s=AGE,
    guidance_age_s=AGE,
    setpoint_age_s=AGE,
    force_aside_N=st.floats(0.0, 3.0),
    robot_apart_m=LENGTH,
    offboard=st.booleans(),
    autopilot_lands=st.booleans(),
    hand_force_N=st.floats(0.0, 8.0),
    head_clearance_m=LENGTH,
    hand_clearance_m=LENGTH,
    robot_outside_m=LENGTH,
    above_ceiling_m=LENGTH,
    bias_change_N=st.floats(0.0, 1.0),
    energy_created_J=st.floats(0.0, 1e-5),
    tank_scale=st.floats(0.0, 1.0),
    battery_fraction=st.floats(0.0, 1.0),
    stall_s=st.floats(0.0, 0.3),
    loop_lag_s=st.floats(0.0, 0.1),
    killed=st.booleans(),
    cable_short_m=st.floats(-0.2, 0.2),
    cable_caught_m=st.floats(-0.2, 0.2),
)
SMALL_IS_BAD = {"head_clearance_m", "hand_clearance_m", "battery_fraction", "offboard", "tank_scale"}


def worse(a: Facts, b: Facts) -> Facts:
    """The worse of each fact."""
    facts = zip(Facts._fields, a, b, strict=True)
    return Facts._make(min(x, y) if name in SMALL_IS_BAD else max(x, y) for name, x, y in facts)


@given(st.lists(st.tuples(FACTS, FACTS, st.integers(1, 30), st.booleans()), max_size=6), st.sampled_from(sorted(Phase)))
def test_worse_facts_never_lower_the_level(history: list[tuple[Facts, Facts, int, bool]], phase: Phase) -> None:
    """Two histories, one at least as bad at each tick: all that is active in the better is active in the worse."""
    one, other = rules.initial(), rules.initial()
    for facts, more, ticks, resume in history:
        for n in range(ticks):
            one, active = rules.step(one, facts, phase, resume and n == 0, DT, P)
            other, graver = rules.step(other, worse(facts, more), phase, resume and n == 0, DT, P)
            assert {rule.name for rule in active} <= {rule.name for rule in graver}


@given(FACTS, st.sampled_from(sorted(FLYING)))
def test_a_held_level_does_not_fall_by_itself(facts: Facts, phase: Phase) -> None:
    state, active = watch(facts, 2.5, phase)
    held = {name for name in active if NAMES[name].level >= Level.HOLD}
    assert held <= set(watch(FINE, 5.0, Phase.HOLD, state)[1])
