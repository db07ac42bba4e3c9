"""What is promised of every fault, and how a window is held to it."""

from schemas.safety import Level, Permit
from schemas.topics import SAFETY_STATE, SETPOINT
from schemas.vehicle import SetpointKind
from services.faults.fault import Fault, Reaction
from tests.processes.window import Window

FORCE_N, CALM_N = 2.5, 0.3
SILENT_S, PERMIT_S = 0.1, 0.2
LOST_S, SINK_S = 0.9, 1.5
"""PX4 lands by itself so long after the last set-point; and then takes so long to be seen sinking."""
ENGAGES = {Permit.WAIT, Permit.GUIDE}
TURN_S = 0.05
"""What a real loop adds to the virtual clock's time: its turn, the way over the bus, the next loop's turn."""


def assert_pulled(w: Window) -> None:
    """Else nothing was there to be taken away."""
    assert w.pull_N(-0.5, 0.0) > 0.5, f"nothing was pulling: {w}"


def assert_force(w: Window) -> None:
    """Never more than before, or 2.5 N."""
    assert w.commanded_N() <= max(w.commanded_N(-0.5, 0.0), FORCE_N) + 1e-3, w


def assert_backs_off(w: Window, within_s: float) -> None:
    """In time, and then without a pull. What the host took away meanwhile is nobody's reaction."""
    assert w.backs_off_s() < within_s + TURN_S + w.waited_s(within_s + 1.0), w
    assert w.pull_after_N() < CALM_N, w
    assert_force(w)


def assert_permitted(w: Window) -> None:
    """No guiding by a permit that is older than the bridge's own limit, or that there never was."""
    states = w.all(SAFETY_STATE, -1.0)
    for t, m in w.all(SETPOINT, PERMIT_S + TURN_S):
        if m.kind is SetpointKind.ADMITTANCE:
            told = {state.permit for at, state in states if t - PERMIT_S - TURN_S <= at <= t}
            assert told & ENGAGES, f"guided after {t:.3f} s with {told or 'no permit'}: {w}"


def assert_reaction(w: Window, fault: Fault, since_s: float = 0.0) -> None:
    """What the campaign on virtual time promises of this fault, counted from `since_s`, and of every fault."""
    if fault.reaction is Reaction.AUTOPILOT_LANDS:
        assert_left_to_the_autopilot(w)
    elif fault.reaction is not Reaction.ANY:
        reacts_s = w.backs_off_s() if fault.reaction is Reaction.EASE else w.comes_down_s()
        within_s = since_s + fault.within_s
        assert reacts_s < within_s + TURN_S + w.waited_s(within_s + 1.0), w
    assert "calm" in fault.exempt or w.pull_after_N() < CALM_N, w
    assert_force(w)
    assert_permitted(w)


def assert_left_to_the_autopilot(w: Window) -> None:
    """No set-point any more, and it sinks as soon as the autopilot has missed them."""
    assert_silent(w)
    assert w.sinks_s() < LOST_S + SINK_S + w.waited_s(LOST_S + SINK_S), w


def assert_silent(w: Window) -> None:
    """No set-point leaves more than 0.1 s after the loop that makes them stood still, not even when it goes on."""
    late_s = [t for t, _ in w.all(SETPOINT, SILENT_S)]
    assert not late_s, f"set-points at {late_s[:5]}: {w}"


def assert_unnoticed(w: Window) -> None:
    """Nothing above a warning, and the pull is there all the time."""
    assert max(w.levels()) <= Level.WARN, w
    assert w.backs_off_s() == float("inf"), w
    assert len(w.all(SAFETY_STATE)) > 10
    assert_force(w)
