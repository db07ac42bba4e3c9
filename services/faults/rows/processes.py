"""Services that die, stand still, or start again, in every phase."""

import itertools
from collections.abc import Iterator

from schemas.safety import Phase
from schemas.topics import TOPICS
from services.config import load
from services.faults.fault import GUIDING, Fault, Group, Moment, Reaction
from services.faults.rows.common import MOMENTS, SINKS, Act, later
from services.rehearsal import meddled_bus
from services.rehearsal.chain import Stage


def processes() -> Iterator[Fault]:
    """Each service in each phase: killed, standing still, and killed and started again."""
    for name, moment in itertools.product(("tracker", "force_estimator", "guiding_controller"), MOMENTS):
        yield _death((name,), moment, *_after_death(name, moment.phase))
    for moment in MOMENTS:
        lands = Reaction.LAND if moment.phase is Phase.LANDING else Reaction.EASE
        yield _death(("safety_supervisor",), moment, lands, 0.3, watch_s=12.0)
        yield _death(("px4_bridge",), moment, Reaction.AUTOPILOT_LANDS, 1.0, watch_s=12.0)
        yield _gateway(moment)
    yield _death(("safety_supervisor", "px4_bridge"), GUIDING, Reaction.AUTOPILOT_LANDS, 1.0, watch_s=12.0)
    for name, moment in itertools.product(RUNNING, MOMENTS):
        for seconds in (0.3, 1.0, 5.0):
            yield _pause(name, seconds, moment)
        yield _again(name, moment)


RUNNING = ("tracker", "force_estimator", "guiding_controller", "safety_supervisor", "px4_bridge")
ENGAGED = (Phase.READY, Phase.GUIDING, Phase.ARRIVED)


def _pause(name: str, seconds: float, moment: Moment) -> Fault:
    reaction, within_s = _after_gap(name, moment.phase)
    if seconds < 0.5 and name in ("px4_bridge", "tracker"):
        reaction, within_s = Reaction.ANY, 0.0
    return Fault(
        f"stop_{name}_{seconds:g}s_in_{moment.phase}".replace(".", "_"),
        Group.PROCESS,
        f"{name} stands still for {seconds:g} s in {moment.phase} (SIGSTOP)",
        reaction,
        within_s,
        _stopped(name, seconds),
        moment,
        watch_s=seconds + (4.0 if moment is GUIDING else 2.5),  # until the pull is back
        exempt=_sinks(name, moment),
        family=f"{name} stands still",
    )


def _again(name: str, moment: Moment) -> Fault:
    return Fault(
        f"restart_{name}_in_{moment.phase}",
        Group.PROCESS,
        f"{name} is killed in {moment.phase} and started again after 1 s",
        *_after_gap(name, moment.phase),
        _restarted(name, 1.0),
        moment,
        watch_s=6.0,
        exempt=_sinks(name, moment),
        family=f"{name} restarted",
    )


def _sinks(name: str, moment: Moment) -> dict[str, str]:
    """The autopilot lands after a second without the bridge, on whoever is under it."""
    return SINKS if name == "px4_bridge" and moment.phase in ENGAGED else {}


def _after_gap(name: str, phase: Phase) -> tuple[Reaction, float]:
    """What a second without a service must lead to in a phase."""
    if name == "px4_bridge":
        return Reaction.AUTOPILOT_LANDS, 1.0
    if name == "safety_supervisor":
        return (Reaction.ANY, 0.0) if phase is Phase.LANDING else (Reaction.EASE, 0.3)
    if name == "tracker" and phase not in ENGAGED:
        return Reaction.ANY, 0.0  # the autopilot bridges a second
    return _after_death(name, phase)


def _after_death(name: str, phase: Phase) -> tuple[Reaction, float]:
    """What the death of a service must lead to in a phase."""
    if name == "tracker":  # the autopilot has no position any more
        return (Reaction.EASE, 0.3) if phase in ENGAGED else (Reaction.LAND, 3.0)
    if name == "force_estimator":
        return (Reaction.EASE, 0.2) if phase in ENGAGED else (Reaction.ANY, 0.0)
    return (Reaction.EASE, 0.2) if phase in (Phase.GUIDING, Phase.ARRIVED) else (Reaction.ANY, 0.0)


def _death(names: tuple[str, ...], moment: Moment, reaction: Reaction, within_s: float, watch_s: float = 5.0) -> Fault:
    def act(stage: Stage) -> None:
        for name in names:
            stage.kill(name)

    told = " and ".join(names)
    under = watch_s > 5.0 and moment.phase in ENGAGED
    name = f"kill_{'_and_'.join(names)}_in_{moment.phase}"
    return Fault(
        name,
        Group.PROCESS,
        f"{told} killed in {moment.phase}",
        reaction,
        within_s,
        act,
        moment,
        watch_s,
        exempt=SINKS if under else {},
        family=f"{told} killed",
    )


def _gateway(moment: Moment) -> Fault:
    """Whichever it is: for the drone the ground has fallen silent, for as long as nobody starts another."""
    return Fault(
        f"kill_gateway_in_{moment.phase}",
        Group.PROCESS,
        f"a gateway killed in {moment.phase}: nothing that the ground says arrives",
        *_after_death("tracker", moment.phase),
        _silence_the_ground,
        moment,
        family="gateway killed",
    )


def _silence_the_ground(stage: Stage) -> None:
    config = load("ground-sim")
    for topic in TOPICS:
        heard_by = {config.host_of(name) for name in topic.subscribers}
        if config.host_of(topic.publisher) == "ground" and "drone" in heard_by:
            stage.bus.meddle[topic.key] = meddled_bus.dropped


def _stopped(name: str, seconds: float) -> Act:
    def act(stage: Stage) -> None:
        stage.stop(name)
        later(seconds, lambda: stage.go_on(name))

    return act


def _restarted(name: str, seconds: float) -> Act:
    def act(stage: Stage) -> None:
        stage.kill(name)
        later(seconds, lambda: stage.begin(name))

    return act
