"""What no sequence of inputs can bring about: a state machine is safe in its histories, not in its transitions."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from schemas.estimation import Tare
from schemas.safety import Action, Level, Permit, Phase
from services.safety_supervisor import phases
from services.safety_supervisor.phases import Decision, PhaseState, Seen
from tests.laws.test_phases import DT, FAR, ROUTE, P

# Mostly quiet, so that every phase is reached, with anything at any time.
ACTIONS = st.sampled_from([None, None, None, None, *Action])
LEVELS = st.sampled_from([Level.OK] * 8 + [level for level in Level if level is not Level.KILL])  # no rule kills
PLACES = st.sampled_from([ROUTE.start, *ROUTE.clearing, FAR])
SIGHTS = st.builds(
    Seen,
    action=ACTIONS,
    level=LEVELS,
    p_R=PLACES,
    v_R=st.just(np.zeros(3)),
    armed=st.sampled_from([True, True, True, True, False, None]),
    tare=st.sampled_from(list(Tare)),
    held=st.booleans(),
    end_distance_m=st.sampled_from([0.0, 9.0]),
)
HISTORIES = st.lists(st.tuples(SIGHTS, st.integers(1, 12)), min_size=5, max_size=25)
FIRST = st.sampled_from(list(Phase))


def play(first: Phase, history: list[tuple[Seen, int]]) -> list[tuple[Seen, PhaseState, Decision]]:
    """Each sight for some ticks (its command once), from any phase."""
    state, told = PhaseState(first, back_to=Phase.GUIDING), []
    for sight, ticks in history:
        for n in range(ticks):
            seen = sight if n == 0 else sight._replace(action=None)
            state, decision = phases.step(state, seen, DT, ROUTE, P)
            told.append((seen, state, decision))
    return told


@given(FIRST, HISTORIES)
def test_guide_only_while_guiding_and_below_ease(first: Phase, history: list[tuple[Seen, int]]) -> None:
    for seen, state, decision in play(first, history):
        if decision.permit is Permit.GUIDE:
            assert state.phase in (Phase.GUIDING, Phase.ARRIVED)
            assert max(seen.level, state.operator_level) < Level.EASE
        if decision.permit is Permit.NONE:
            assert state.phase in (Phase.IDLE, Phase.LANDED)


@given(FIRST, HISTORIES)
def test_the_ground_is_reached_only_disarmed_and_never_left_uncalled(
    first: Phase, history: list[tuple[Seen, int]]
) -> None:
    told = play(first, history)
    for (_, before, _), (seen, state, _) in pairwise(told):
        if state.phase is Phase.LANDED is not before.phase:
            assert seen.armed is False
        if state.phase is Phase.IDLE:
            assert before.phase is Phase.IDLE
        if before.phase is Phase.LANDED:
            assert state.phase in (Phase.LANDED, Phase.KILLED)
        if state.phase is Phase.KILLED is not before.phase:
            assert seen.action is Action.KILL
            continue
        if before.phase is Phase.IDLE is not state.phase:
            if state.phase is Phase.HOLD:
                assert seen.armed  # this supervisor began in flight
            else:
                assert (state.phase, seen.action) == (Phase.TAKEOFF, Action.START)
                assert seen.level < Level.EASE


@given(FIRST, HISTORIES)
def test_a_command_only_raises_the_level_until_resume(first: Phase, history: list[tuple[Seen, int]]) -> None:
    asked = {Action.EASE: Level.EASE, Action.HOLD: Level.HOLD, Action.LAND: Level.LAND, Action.KILL: Level.KILL}
    for (_, before, _), (seen, state, _) in pairwise(play(first, history)):
        if before.phase is Phase.IDLE:
            continue  # starting begins anew
        if seen.action is not None and seen.action in asked:
            assert state.operator_level == max(before.operator_level, asked[seen.action])
        elif seen.action is Action.RESUME and before.operator_level < Level.LAND:
            assert state.operator_level is Level.OK
        else:
            assert state.operator_level is before.operator_level


@given(FIRST, HISTORIES)
def test_hold_is_left_only_by_a_person_or_downwards(first: Phase, history: list[tuple[Seen, int]]) -> None:
    origin = Phase.GUIDING if first is Phase.HOLD else first  # where the first step may already have left from
    for (_, before, _), (seen, state, _) in pairwise(play(first, history)):
        if state.phase is Phase.HOLD is not before.phase:
            origin = before.phase
        if before.phase is Phase.HOLD is not state.phase:
            level = max(seen.level, state.operator_level)
            if level >= Level.LAND:
                assert state.phase in (Phase.CLEARING, Phase.LANDING, Phase.KILLED)
            elif seen.armed is False:
                assert state.phase is Phase.LANDING  # it has come down meanwhile
            else:
                # a supervisor that began in flight has nothing to go back to: it only flies aside and lands
                back = Phase.CLEARING if origin is Phase.IDLE else origin
                assert (state.phase, seen.action) == (back, Action.RESUME)
                assert level < Level.EASE


@given(FIRST, HISTORIES)
def test_a_flight_never_goes_back(first: Phase, history: list[tuple[Seen, int]]) -> None:
    """But for HOLD, the phases come in the order of the experiment."""
    order = [p for p in Phase if p is not Phase.HOLD]
    flown = [state.phase for _, state, _ in play(first, history) if state.phase is not Phase.HOLD]
    begun = flown[next((n for n, p in enumerate(flown) if p is not Phase.IDLE), 0) :]
    if first is not Phase.HOLD:
        assert all(order.index(a) <= order.index(b) for a, b in pairwise(begun))


@given(FIRST, HISTORIES)
def test_every_tick_says_where_to_and_how_fast(first: Phase, history: list[tuple[Seen, int]]) -> None:
    for _, state, decision in play(first, history):
        assert np.all(np.isfinite(decision.goal))
        assert 0.0 < decision.speed_mps <= P.fast_mps
        assert decision.tare == (state.phase is Phase.ZEROING)
