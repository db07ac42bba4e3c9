"""The experiment as a state machine: each transition by its own cause, and what no sequence of inputs can bring about."""

import numpy as np
import pytest

from schemas.estimation import Tare
from schemas.safety import Action, Level, Permit, Phase
from services.safety_supervisor import phases
from services.safety_supervisor.phases import Decision, PhaseState, Plan, Seen, Times

P = Times(
    settle_s=1.0,
    settle_m=0.1,
    settle_mps=0.15,
    held_s=0.5,
    released_s=0.7,
    regrasp_s=3.0,
    arrived_s=0.6,
    arrived_m=0.1,
    step_back_s=0.8,
    takeoff_limit_s=5.0,
    clearing_limit_s=20.0,
    ready_limit_s=4.0,
    fast_mps=0.6,
    slow_mps=0.4,
)
DT = 0.1
ROUTE = Plan(np.array([0.0, 0.0, 2.0]), (np.array([3.0, 0, 2]), np.array([3.0, 0, 1]), np.array([3.0, 1, 1])))
FAR = np.array([9.0, 9.0, 0.0])
FLYING = tuple(p for p in Phase if p not in (Phase.IDLE, Phase.LANDED, Phase.KILLED))
OBEYING = tuple(p for p in FLYING if p is not Phase.LANDING)  # from there only the ground is left
BEFORE_HOLD = tuple(p for p in OBEYING if p is not Phase.HOLD)
CALM = Seen(None, Level.OK, FAR, np.zeros(3), armed=True, tare=Tare.NONE, held=False, end_distance_m=9.0)


def tick(state: PhaseState, **seen: object) -> tuple[PhaseState, Decision]:
    at_rest = {"armed": state.phase is not Phase.IDLE}  # whatever is armed when the supervisor begins, flies already
    return phases.step(state, CALM._replace(**(at_rest | seen)), DT, ROUTE, P)


def after(state: PhaseState, seconds: float, **seen: object) -> PhaseState:
    for _ in range(round(seconds / DT)):
        state, _ = tick(state, **seen)
    return state


def leaves_after(phase: Phase, limit_s: float, **seen: object) -> tuple[float, PhaseState]:
    """How long `phase` lasts under the same input, and what follows."""
    state = PhaseState(phase)
    for n in range(round(limit_s / DT) + 1):
        state, _ = tick(state, **seen)
        if state.phase is not phase:
            return (n + 1) * DT, state
    raise AssertionError(f"{phase} lasts longer than {limit_s} s")


AT_START = {"p_R": ROUTE.start}
AT_END = {"held": True, "end_distance_m": 0.05}


@pytest.mark.parametrize(
    ("phase", "seen", "to", "seconds"),
    [
        (Phase.IDLE, {"action": Action.START}, Phase.TAKEOFF, 0.0),
        (Phase.TAKEOFF, AT_START, Phase.ZEROING, P.settle_s),
        (Phase.TAKEOFF, {}, Phase.LANDING, P.takeoff_limit_s),
        (Phase.ZEROING, {"tare": Tare.PASSED}, Phase.READY, 0.5),
        (Phase.ZEROING, {"tare": Tare.FAILED}, Phase.CLEARING, 0.0),
        (Phase.ZEROING, {"tare": Tare.RUNNING}, Phase.CLEARING, P.takeoff_limit_s),
        (Phase.READY, {"held": True}, Phase.GUIDING, P.held_s),
        (Phase.READY, {}, Phase.CLEARING, P.ready_limit_s),
        (Phase.GUIDING, AT_END, Phase.ARRIVED, P.arrived_s),
        (Phase.GUIDING, {}, Phase.CLEARING, P.regrasp_s),
        (Phase.ARRIVED, {}, Phase.CLEARING, P.released_s),
        (Phase.CLEARING, {"armed": False}, Phase.LANDING, 0.0),
        (Phase.LANDING, {"armed": False}, Phase.LANDED, 0.0),
    ],
)
def test_each_phase_ends_by_its_own_cause_and_after_its_own_time(
    phase: Phase, seen: dict[str, object], to: Phase, seconds: float
) -> None:
    took, state = leaves_after(phase, seconds + 3 * DT, **seen)
    assert state.phase is to
    assert (
        seconds - 1e-9 <= took <= seconds + 2.5 * DT
    )  # a limit is passed, not met, and time begins with the next tick


@pytest.mark.parametrize(
    ("phase", "seen"),
    [
        (Phase.IDLE, {}),
        (Phase.IDLE, {"action": Action.RESUME}),
        (Phase.IDLE, {"action": Action.START, "level": Level.EASE}),
        (Phase.READY, {"held": True, "level": Level.EASE}),
        (Phase.GUIDING, {"held": True}),
        (Phase.GUIDING, {"held": True, "end_distance_m": P.arrived_m + 0.01}),
        (Phase.ARRIVED, AT_END),
        (Phase.LANDING, {"action": Action.RESUME}),
        (Phase.LANDED, {"action": Action.START, "armed": False}),
        (Phase.HOLD, {}),
    ],
)
def test_nothing_ends_without_its_cause(phase: Phase, seen: dict[str, object]) -> None:
    assert after(PhaseState(phase), 3.5, **seen).phase is phase


@pytest.mark.parametrize("spoiled", [{"p_R": FAR}, {"v_R": np.array([0.2, 0.0, 0.0])}])
def test_settling_is_near_and_slow_without_a_break(spoiled: dict[str, object]) -> None:
    nearly = after(PhaseState(Phase.TAKEOFF), 0.9, **AT_START)
    broken = after(nearly, DT, **AT_START | spoiled)
    assert after(broken, 0.9, **AT_START).phase is Phase.TAKEOFF
    assert after(broken, 1.1, **AT_START).phase is Phase.ZEROING


def test_a_hand_that_lets_go_before_the_time_begins_anew() -> None:
    taken = after(PhaseState(Phase.READY), 0.4, held=True)
    assert after(after(taken, DT, held=False), 0.4, held=True).phase is Phase.READY
    assert after(taken, 0.2, held=True).phase is Phase.GUIDING


def test_taking_the_handle_again_in_time_goes_on() -> None:
    state = PhaseState(Phase.GUIDING)
    for _ in range(4):
        state = after(after(state, P.regrasp_s - 0.2, held=False), DT, held=True)
    assert state.phase is Phase.GUIDING


def test_an_old_result_of_zeroing_does_not_count() -> None:
    """The estimator needs a moment to begin; until then it still says what came of the last time."""
    assert after(PhaseState(Phase.ZEROING), 0.4, tare=Tare.PASSED).phase is Phase.ZEROING


def test_zeroing_is_asked_for_only_while_zeroing() -> None:
    asked = {phase for phase in Phase if tick(PhaseState(phase), tare=Tare.RUNNING)[1].tare}
    assert asked == {Phase.ZEROING}


def test_clearing_waits_for_the_person_then_flies_leg_by_leg() -> None:
    state = PhaseState(Phase.CLEARING)
    stood = state
    for _ in range(round(P.step_back_s / DT)):
        stood, decision = tick(stood)
        assert decision.permit is Permit.EASE
    state = after(state, P.step_back_s + 0.3)
    for n, goal in enumerate(ROUTE.clearing):
        away = after(state, 5.0)
        state, decision = tick(away)
        assert (state.phase, state.leg, decision.permit) == (Phase.CLEARING, n + 1, Permit.POSITION)
        assert np.array_equal(decision.goal, goal)
        assert decision.speed_mps == P.slow_mps
        state, _ = tick(state, p_R=goal + [0.0, 0.0, 1.9 * P.settle_m])
    assert state.phase is Phase.LANDING


def test_the_permits_of_a_calm_flight() -> None:
    expected = {
        Phase.IDLE: Permit.NONE,
        Phase.TAKEOFF: Permit.POSITION,
        Phase.ZEROING: Permit.POSITION,
        Phase.READY: Permit.WAIT,
        Phase.GUIDING: Permit.GUIDE,
        Phase.ARRIVED: Permit.GUIDE,
        Phase.CLEARING: Permit.EASE,
        Phase.LANDING: Permit.LAND,
        Phase.LANDED: Permit.NONE,
        Phase.HOLD: Permit.HOLD,
        Phase.KILLED: Permit.KILL,
    }
    assert {phase: tick(PhaseState(phase), held=True)[1].permit for phase in Phase} == expected


@pytest.mark.parametrize("phase", OBEYING)
@pytest.mark.parametrize(
    "by", [{"level": Level.DESCEND}, {"level": Level.DESCEND, "action": Action.RESUME}], ids=["told", "resumed"]
)
def test_descend_lands_at_once(phase: Phase, by: dict[str, object]) -> None:
    state, decision = tick(PhaseState(phase), **by)
    assert (state.phase, decision.permit) == (Phase.LANDING, Permit.LAND)


@pytest.mark.parametrize("phase", BEFORE_HOLD)
@pytest.mark.parametrize("by", [{"level": Level.HOLD}, {"action": Action.HOLD}], ids=["rule", "person"])
def test_hold_stops_everything_and_goes_back_to_where_it_was(phase: Phase, by: dict[str, object]) -> None:
    held, decision = tick(PhaseState(phase), **by)
    assert (held.phase, decision.permit) == (Phase.HOLD, Permit.HOLD)
    waited = after(held, 2.0)
    assert waited.phase is Phase.HOLD
    blocked = after(waited, DT, action=Action.RESUME, level=Level.EASE)
    assert blocked.phase is Phase.HOLD
    assert after(waited, DT, action=Action.RESUME).phase is phase


@pytest.mark.parametrize("phase", [p for p in BEFORE_HOLD if p is not Phase.CLEARING] + [Phase.HOLD])
@pytest.mark.parametrize("by", [{"level": Level.LAND}, {"action": Action.LAND}], ids=["rule", "person"])
def test_land_means_clear_first(phase: Phase, by: dict[str, object]) -> None:
    assert tick(PhaseState(phase), **by)[0].phase is Phase.CLEARING


def test_clearing_that_was_asked_for_goes_on_to_the_ground() -> None:
    """The wish to land stays: it must neither begin the clearing again and again nor stop it."""
    state, _ = tick(PhaseState(Phase.GUIDING), action=Action.LAND)
    state = after(state, P.step_back_s + 0.3, action=Action.HOLD)
    for goal in ROUTE.clearing:
        state, _ = tick(state, p_R=goal)
    assert state.phase is Phase.LANDING


@pytest.mark.parametrize("phase", [Phase.TAKEOFF, Phase.HOLD])
def test_asked_to_land_on_the_ground_it_stays_there(phase: Phase) -> None:
    """A vehicle that never armed, or disarmed by itself, has no route to fly."""
    state, _ = tick(PhaseState(phase), action=Action.LAND, armed=False)
    assert after(state, 3 * DT, armed=False).phase is Phase.LANDED


@pytest.mark.parametrize("phase", [Phase.CLEARING, Phase.LANDING, Phase.HOLD])
def test_a_vehicle_that_has_not_said_whether_it_is_armed_has_not_landed(phase: Phase) -> None:
    assert after(PhaseState(phase), 3 * DT, armed=None).phase is phase


def test_resume_cannot_take_back_a_landing() -> None:
    state, _ = tick(PhaseState(Phase.READY), action=Action.LAND)
    state, _ = tick(state, action=Action.RESUME)
    assert state.operator_level is Level.LAND


def test_ease_is_taken_back_by_resume_in_the_same_phase() -> None:
    eased, decision = tick(PhaseState(Phase.GUIDING), held=True, action=Action.EASE)
    assert (eased.phase, decision.permit) == (Phase.GUIDING, Permit.EASE)
    later = after(eased, 5.0, held=True)
    assert tick(later, held=True)[1].permit is Permit.EASE
    assert tick(later, held=True, action=Action.RESUME)[1].permit is Permit.GUIDE


@pytest.mark.parametrize("level", list(Level))
@pytest.mark.parametrize("phase", [Phase.READY, Phase.GUIDING, Phase.ARRIVED])
def test_no_pull_from_ease_on(phase: Phase, level: Level) -> None:
    permit = tick(PhaseState(phase), held=True, level=level)[1].permit
    assert (permit in (Permit.WAIT, Permit.GUIDE)) == (level < Level.EASE)


@pytest.mark.parametrize("phase", list(Phase))
def test_kill_stops_the_motors_from_every_phase_for_good(phase: Phase) -> None:
    killed, decision = tick(PhaseState(phase), action=Action.KILL)
    assert (killed.phase, decision.permit) == (Phase.KILLED, Permit.KILL)
    for action in Action:
        assert after(killed, 1.0, action=action, armed=False).phase is Phase.KILLED
    assert killed.operator_level is Level.KILL


@pytest.mark.parametrize("phase", [p for p in Phase if p is not Phase.KILLED])
def test_only_a_person_stops_the_motors(phase: Phase) -> None:
    for level in Level:
        if level is not Level.KILL:
            assert after(PhaseState(phase), 1.0, level=level).phase is not Phase.KILLED


@pytest.mark.parametrize("phase", list(Phase))
def test_a_pilots_kill_switch_ends_a_flight_for_good_and_on_the_ground_keeps_it_there(phase: Phase) -> None:
    state, decision = tick(PhaseState(phase), level=Level.KILL, action=Action.START, armed=False)
    if phase in (Phase.IDLE, Phase.LANDED):
        assert (state.phase, decision.permit) == (phase, Permit.NONE)
    else:
        assert (after(state, 1.0, armed=False).phase, decision.permit) == (Phase.KILLED, Permit.KILL)
        assert phase is Phase.KILLED or state.operator_level is Level.KILL


def test_a_clearing_that_does_not_get_on_ends_in_a_landing() -> None:
    """Somebody who does not let go keeps the vehicle near: then it comes down there."""
    took, state = leaves_after(Phase.CLEARING, P.clearing_limit_s + 1.0, held=True)
    assert state.phase is Phase.LANDING
    assert took > P.clearing_limit_s


def test_a_supervisor_that_begins_in_flight_holds_and_then_only_lands() -> None:
    begun, decision = tick(PhaseState(Phase.IDLE), armed=True)
    assert (begun.phase, decision.permit) == (Phase.HOLD, Permit.HOLD)
    assert "began in flight" in begun.why
    assert after(begun, 5.0, held=True).phase is Phase.HOLD
    assert tick(begun, action=Action.RESUME)[0].phase is Phase.CLEARING
    assert after(begun, 3 * DT, armed=False).phase is Phase.LANDED


def test_asked_to_land_on_the_way_it_lands_beside_the_handle() -> None:
    """The route of the end of the path, moved to where the vehicle is, and never through a wall."""
    here = np.array([-1.0, 0.4, 1.7])
    hall = phases.Hall(np.array([1.0, 0.0, 2.0]), np.array([-4.0, -3.0, 0.0]), np.array([1.5, 3.0, 3.0]))
    route = ROUTE._replace(hall=hall)
    state, _ = phases.step(PhaseState(Phase.GUIDING), CALM._replace(action=Action.LAND, p_R=here), DT, route, P)
    goals = []
    while state.phase is Phase.CLEARING:
        state, decision = phases.step(state, CALM._replace(p_R=goals[-1] if goals else here), DT, route, P)
        if decision.permit is Permit.POSITION and not any(np.array_equal(decision.goal, g) for g in goals):
            goals.append(decision.goal)
    assert np.allclose(goals, [[1.0, 0.4, 2.0], [1.0, 0.4, 1.0], [1.0, 1.4, 1.0]])
    wall = route._replace(hall=hall._replace(high=np.array([0.3, 3.0, 3.0])))
    begun = PhaseState(Phase.CLEARING, leg=1, shift_m=(-2.0, 0.4))
    assert phases.step(begun, CALM, DT, wall, P)[1].goal[0] == 0.3
