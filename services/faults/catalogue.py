"""All faults that can be tried on virtual time, each one row. What needs real processes is in tests/faults."""

import asyncio
import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from schemas.safety import Action, Phase
from schemas.topics import (
    CABLE_FORCE,
    GUIDANCE,
    HANDLE_STATE,
    MOCAP_FRAME,
    SAFETY_STATE,
    VEHICLE_IMU,
    VEHICLE_STATE,
    Topic,
)
from services.config import Config
from services.faults import meddled_bus as bus
from services.faults.chain import Stage
from services.faults.direct_vehicle import Messages
from services.faults.fault import GUIDING, Fault, Group, Moment, Reaction
from services.simulator.commander import Arm, Mode, SetOrigin, SetParameter, Switch
from services.simulator.human import Event, Kind

Act = Callable[[Stage], None]
MOMENTS = (
    Moment(Phase.TAKEOFF, 2.0),
    Moment(Phase.ZEROING, 0.5),
    Moment(Phase.READY, 1.0),
    GUIDING,
    Moment(Phase.ARRIVED, 0.5),
    Moment(Phase.CLEARING, 2.0),
    Moment(Phase.LANDING, 0.6),
)
OVERHEAD = "the autopilot comes straight down, and the person stands under it until told to step back"
DRAGGED = "the autopilot sinks with the cable in the person's hand"


def every() -> tuple[Fault, ...]:
    """The whole campaign."""
    return (*_processes(), *_messages(), *_sensing(), *_vehicle(), *_person(), *_clocks(), *_operator())


def named(name: str) -> Fault | None:
    """The fault of that name."""
    return next((fault for fault in every() if fault.name == name), None)


# Processes


def _processes() -> Iterator[Fault]:
    for name, moment in itertools.product(("tracker", "force_estimator", "guiding_controller"), MOMENTS):
        yield _death((name,), moment, *_after_death(name, moment.phase))
    for moment in MOMENTS:
        lands = Reaction.LAND if moment.phase is Phase.LANDING else Reaction.EASE
        yield _death(("safety_supervisor",), moment, lands, 0.3, watch_s=9.0)
        yield _death(("px4_bridge",), moment, Reaction.AUTOPILOT_LANDS, 1.0, watch_s=9.0)
    yield _death(("safety_supervisor", "px4_bridge"), GUIDING, Reaction.AUTOPILOT_LANDS, 1.0, watch_s=9.0)
    for name, seconds in itertools.product(RUNNING, (0.3, 1.0, 5.0)):
        reaction, within_s = STOPPED[name]
        if seconds < 0.5 and name in ("px4_bridge", "tracker"):
            reaction, within_s = Reaction.ANY, 0.0
        text = f"{name} stands still for {seconds:g} s (SIGSTOP)"
        about = f"stop_{name}_{seconds:g}s".replace(".", "_")
        yield Fault(
            about,
            Group.PROCESS,
            text,
            reaction,
            within_s,
            _stopped(name, seconds),
            watch_s=seconds + 4.0,
            family=f"{name} stands still",
        )
    for name in RUNNING:
        reaction, within_s = STOPPED[name]
        text = f"{name} is killed and started again after 1 s"
        yield Fault(
            f"restart_{name}",
            Group.PROCESS,
            text,
            reaction,
            within_s,
            _restarted(name, 1.0),
            watch_s=7.0,
            family=f"{name} restarted",
        )


RUNNING = ("tracker", "force_estimator", "guiding_controller", "safety_supervisor", "px4_bridge")
STOPPED = {
    "tracker": (Reaction.EASE, 0.3),
    "force_estimator": (Reaction.EASE, 0.2),
    "guiding_controller": (Reaction.EASE, 0.2),
    "safety_supervisor": (Reaction.EASE, 0.3),
    "px4_bridge": (Reaction.AUTOPILOT_LANDS, 1.0),
}


def _after_death(name: str, phase: Phase) -> tuple[Reaction, float]:
    """What the death of a service must lead to in a phase."""
    if name == "tracker":  # the autopilot has no position any more
        engaged = phase in (Phase.READY, Phase.GUIDING, Phase.ARRIVED)
        return (Reaction.EASE, 0.3) if engaged else (Reaction.LAND, 2.5)
    if name == "force_estimator":
        return (Reaction.EASE, 0.2) if phase in (Phase.READY, Phase.GUIDING, Phase.ARRIVED) else (Reaction.ANY, 0.0)
    return (Reaction.EASE, 0.2) if phase in (Phase.GUIDING, Phase.ARRIVED) else (Reaction.ANY, 0.0)


def _death(names: tuple[str, ...], moment: Moment, reaction: Reaction, within_s: float, watch_s: float = 5.0) -> Fault:
    def act(stage: Stage) -> None:
        for name in names:
            stage.kill(name)

    told = " and ".join(names)
    exempt = dict[str, str]()
    if watch_s > 5.0 and moment.phase in (Phase.READY, Phase.GUIDING, Phase.ARRIVED):
        exempt = {"tip_hand": OVERHEAD, "tip_head": OVERHEAD, "calm": DRAGGED, "armed": DRAGGED, "impact": DRAGGED}
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
        exempt=exempt,
        family=f"{told} killed",
    )


def _later(stage: Stage, seconds: float, act: Callable[[], object]) -> None:
    asyncio.get_running_loop().call_later(seconds, act)


def _stopped(name: str, seconds: float) -> Act:
    def act(stage: Stage) -> None:
        stage.stop(name)
        _later(stage, seconds, lambda: stage.go_on(name))

    return act


def _restarted(name: str, seconds: float) -> Act:
    def act(stage: Stage) -> None:
        stage.kill(name)
        _later(stage, seconds, lambda: stage.begin(name))

    return act


# Messages

TOPICS: tuple[Topic[Any], ...] = (HANDLE_STATE, CABLE_FORCE, VEHICLE_STATE, GUIDANCE, SAFETY_STATE)
WAYS: dict[str, tuple[str, Callable[[], bus.Meddle]]] = {
    "dropped": ("do not arrive", lambda: bus.dropped),
    "frozen": ("stay the same under new headers", bus.frozen),
    "late": ("arrive 0.5 s late", lambda: bus.delayed(0.5)),
    "doubled": ("arrive twice", lambda: bus.doubled),
    "swapped": ("arrive in the wrong order", bus.swapped),
    "nan": ("have a NaN", lambda: bus.vectors(bus.not_a_number)),
    "thousandfold": ("are in milli-units", lambda: bus.vectors(bus.thousandfold)),
    "ned": ("are in the autopilot's frame", lambda: bus.vectors(bus.north_east_down)),
}
HARMLESS = ("doubled", "swapped")


def _messages() -> Iterator[Fault]:
    for topic, (way, (text, meddle)) in itertools.product(TOPICS, WAYS.items()):
        reaction, within_s = _garbled(topic, way)
        name = f"{topic.key.split('/')[0]}_{way}"
        about = f"messages of {topic.key} {text}"
        yield Fault(
            name,
            Group.BUS,
            about,
            reaction,
            within_s,
            _meddled(topic.key, meddle),
            watch_s=5.0,
            family=f"{topic.key} {'in disorder' if way in HARMLESS else 'wrong'}",
        )


def _garbled(topic: Topic[Any], way: str) -> tuple[Reaction, float]:
    """What it must lead to, by when."""
    if way in HARMLESS:
        return Reaction.NOTHING, 0.0
    if topic is SAFETY_STATE and way in ("frozen", "thousandfold", "ned"):  # its vectors matter only in position mode
        return Reaction.ANY, 0.0
    if topic is VEHICLE_STATE and way in ("dropped", "late", "nan"):
        return Reaction.EASE, 0.5
    return Reaction.EASE, 0.4


def _meddled(key: str, meddle: Callable[[], bus.Meddle]) -> Act:
    def act(stage: Stage) -> None:
        stage.bus.meddle[key] = meddle()

    return act


# Sensing


def _sensing() -> Iterator[Fault]:
    S = Group.SENSING
    yield Fault(
        "handle_hidden", S, "the handle is occluded for 3 s", Reaction.ANY, 0.0, _frames(_hidden("handle")), watch_s=6.0
    )
    for axis, by_m in (("x", 0.5), ("x", -0.5), ("y", 0.5), ("z", 0.5)):
        side = f"{'minus' if by_m < 0 else 'plus'}_{axis}"
        about = f"the handle's marker set jumps by {by_m:+.1f} m along {axis}"
        yield Fault(
            f"handle_jumps_{side}", S, about, Reaction.ANY, 0.0, _frames(_jump("handle", axis, by_m)), watch_s=6.0
        )
    yield Fault("robot_lost", S, "motion capture loses the vehicle", Reaction.LAND, 2.5, _frames(_hidden("robot")), watch_s=9.0,
                exempt={"tip_hand": OVERHEAD, "tip_head": OVERHEAD, "calm": DRAGGED, "armed": DRAGGED})  # fmt: skip
    yield Fault(
        "robot_and_handle_swapped",
        S,
        "motion capture takes each for the other",
        Reaction.EASE,
        0.6,
        _frames(_exchanged),
        watch_s=6.0,
    )
    yield Fault(
        "force_bias_drifts",
        S,
        "the thrust is believed ever lower: 0.1 N more of bias in each second",
        Reaction.ANY,
        0.0,
        _thrust(lambda t: -0.1 * t / 8.0),
        watch_s=9.0,
    )
    yield Fault(
        "thrust_20_percent_high",
        S,
        "the motors push 20 % less than they are believed to",
        Reaction.EASE,
        1.5,
        _thrust(lambda t: 0.2),
        watch_s=5.0,
    )
    yield Fault(
        "thrust_20_percent_low",
        S,
        "the motors push 20 % more than they are believed to",
        Reaction.EASE,
        1.5,
        _thrust(lambda t: -0.2),
        watch_s=5.0,
    )
    yield Fault(
        "imu_stuck", S, "the inertial sensor says the same for ever", Reaction.EASE, 0.4, _imu_stuck, watch_s=5.0
    )


Body = dict[str, Any]


def _frames(how: Callable[[dict[str, Any]], dict[str, Any]], for_s: float = 3.0) -> Act:
    def act(stage: Stage) -> None:
        stage.bus.meddle[MOCAP_FRAME.key] = bus.changed(how)
        _later(stage, for_s, lambda: stage.bus.meddle.pop(MOCAP_FRAME.key, None))

    return act


def _hidden(body: str) -> Callable[[Body], Body]:
    return lambda frame: frame | {body: frame[body] | {"tracked": False}}


def _jump(body: str, axis: str, by_m: float) -> Callable[[Body], Body]:
    def move(frame: Body) -> Body:
        p = frame[body]["position_m"]
        return frame | {body: frame[body] | {"position_m": p | {axis: p[axis] + by_m}}}

    return move


def _exchanged(frame: Body) -> Body:
    return frame | {"handle": frame["robot"], "robot": frame["handle"]}


def _thrust(error: Callable[[float], float]) -> Act:
    """The motors' reported use is wrong by that share, `t` s after the fault began."""

    def act(stage: Stage) -> None:
        begin_s = stage.now_s

        def garble(messages: Messages) -> Messages:
            factor = 1.0 + error(stage.now_s - begin_s)
            return [
                (name, fields | {"actuator": [factor * u for u in fields["actuator"]]})
                if name == "ACTUATOR_OUTPUT_STATUS"
                else (name, fields)
                for name, fields in messages
            ]

        stage.flight.vehicle.garble = garble

    return act


def _imu_stuck(stage: Stage) -> None:
    first: dict[str, Any] = {}

    def garble(messages: Messages) -> Messages:
        stuck: Messages = []
        for name, fields in messages:
            if name == "HIGHRES_IMU":
                first.update(fields) if not first else None
                stuck.append((name, first | {"time_usec": fields["time_usec"]}))
            else:
                stuck.append((name, fields))
        return stuck

    stage.flight.vehicle.garble = garble


# Vehicle


def _vehicle() -> Iterator[Fault]:
    V = Group.VEHICLE
    ground = Moment(Phase.IDLE, 0.4)
    yield Fault(
        "offboard_refused",
        V,
        "the autopilot refuses offboard mode",
        Reaction.STAYS_DOWN,
        0.0,
        _refuses(Switch),
        ground,
        6.0,
    )
    yield Fault(
        "arming_denied", V, "the autopilot refuses to arm", Reaction.STAYS_DOWN, 0.0, _refuses(Arm), ground, 6.0
    )
    yield Fault(
        "pilot_takes_over", V, "a pilot switches to Hold by radio control", Reaction.HOLD, 0.6, _pilot(Mode.HOLD)
    )
    yield Fault("pilot_lands", V, "a pilot switches to Land by radio control", Reaction.LAND, 0.1, _pilot(Mode.LAND), watch_s=9.0,
                exempt={"calm": DRAGGED, "tip_hand": DRAGGED, "tip_head": DRAGGED})  # fmt: skip
    for moment in (m for m in MOMENTS if m.phase is not Phase.LANDING):
        name = f"battery_empty_in_{moment.phase}"
        yield Fault(
            name, V, f"the battery falls to 10 % in {moment.phase}", Reaction.LAND, 3.5, _battery(10), moment, 7.0
        )
    yield Fault("mavlink_cut", V, "the link between bridge and autopilot is cut", Reaction.AUTOPILOT_LANDS, 1.0, _cut, watch_s=9.0,
                exempt={"calm": DRAGGED, "tip_hand": DRAGGED, "tip_head": DRAGGED, "late": "they do not arrive"})  # fmt: skip
    yield Fault(
        "offboard_again",
        V,
        "with PX4's default action the link is lost for 1.5 s and comes back",
        Reaction.ANY,
        0.0,
        _blink,
        watch_s=8.0,
    )


def _refuses(request: type[Any]) -> Act:
    def act(stage: Stage) -> None:
        stage.flight.vehicle.refuses = (request,)

    return act


def _pilot(mode: Mode) -> Act:
    def act(stage: Stage) -> None:
        stage.flight.vehicle.pilot(SetOrigin())
        stage.flight.vehicle.pilot(Switch(mode))

    return act


def _battery(percent: int) -> Act:
    def act(stage: Stage) -> None:
        stage.flight.vehicle.garble = lambda messages: [
            (name, fields | {"battery_remaining": percent} if name == "BATTERY_STATUS" else fields)
            for name, fields in messages
        ]

    return act


def _cut(stage: Stage) -> None:
    stage.flight.vehicle.cut = True


def _blink(stage: Stage) -> None:
    stage.flight.vehicle.pilot(SetParameter("COM_OBL_RC_ACT", 0))
    stage.flight.vehicle.cut = True
    _later(stage, 1.5, lambda: setattr(stage.flight.vehicle, "cut", False))


# Person: what they do counts from the moment in which they hold the handle.

DEED_S = 7.0


def _person() -> Iterator[Fault]:
    def deed(name: str, about: str, reaction: Reaction, within_s: float, watch_s: float = 6.0, **event: Any) -> Fault:
        return Fault(
            name, Group.PERSON, about, reaction, within_s, watch_s=watch_s, deeds=(Event(start_s=DEED_S, **event),)
        )

    yield deed("lets_go", "the person opens the hand", Reaction.LET_GO, 0.4, kind=Kind.LET_GO)
    yield deed(
        "stops_30s", "the person stands still for 30 s", Reaction.ANY, 0.0, 31.0, kind=Kind.STOP, duration_s=30.0
    )
    yield deed(
        "runs_ahead",
        "the person runs ahead: 20 N forward for 2 s",
        Reaction.ANY,
        0.0,
        kind=Kind.PUSH,
        duration_s=2.0,
        force_W_N=(20.0, 0.0, 0.0),
    )
    yield deed(
        "runs_back",
        "the person runs back: 20 N for 2 s",
        Reaction.ANY,
        0.0,
        kind=Kind.PUSH,
        duration_s=2.0,
        force_W_N=(-20.0, 0.0, 0.0),
    )
    yield deed(
        "falls",
        "the person falls: the hand drops by 0.8 m at 2 m/s",
        Reaction.LET_GO,
        0.5,
        kind=Kind.RAISE,
        rise_m=-0.8,
        speed_mps=2.0,
    )
    yield deed(
        "pulls_down",
        "the person pulls the hand down by 0.6 m at 1 m/s",
        Reaction.LET_GO,
        0.6,
        kind=Kind.RAISE,
        rise_m=-0.6,
        speed_mps=1.0,
    )
    yield deed(
        "lifts_the_hand",
        "the hand rises by 0.7 m at 0.7 m/s",
        Reaction.ANY,
        0.0,
        kind=Kind.RAISE,
        rise_m=0.7,
        speed_mps=0.7,
    )
    yield replace(
        deed("lifts_the_hand_at_the_start", "the hand rises by 0.7 m at 0.7 m/s under the vehicle", Reaction.ANY, 0.0, kind=Kind.RAISE, rise_m=0.7, speed_mps=0.7),
        deeds=(Event(start_s=1.2, kind=Kind.RAISE, rise_m=0.7, speed_mps=0.7),), moment=Moment(Phase.READY, 0.0),
    )  # fmt: skip
    yield Fault("tangled", Group.PERSON, "the cable is 0.2 m shorter than believed", Reaction.ANY, 0.0, world=_shorter)


def _shorter(config: Config) -> Config:
    cable = replace(config.cable, rest_length_m=config.cable.rest_length_m - 0.2)
    return config.model_copy(update={"cable": cable})


# Clocks: of either host, as its stamps show them.

GROUND = (HANDLE_STATE, GUIDANCE, SAFETY_STATE)
DRONE = (VEHICLE_STATE, CABLE_FORCE, VEHICLE_IMU)


def _clocks() -> Iterator[Fault]:
    for host, by_s in itertools.product(("ground", "drone"), (1.0, -1.0, 3600.0, -3600.0)):
        topics = GROUND if host == "ground" else DRONE
        name = f"clock_of_{host}_{'plus' if by_s > 0 else 'minus'}_{abs(by_s):g}s"
        about = f"the stamps of the {host}'s host jump by {by_s:+g} s"
        yield Fault(
            name,
            Group.CLOCK,
            about,
            Reaction.EASE,
            0.3,
            _jumped(topics, by_s),
            watch_s=5.0,
            family=f"clock of the {host}'s host jumps",
        )


def _jumped(topics: tuple[Topic[Any], ...], by_s: float) -> Act:
    def act(stage: Stage) -> None:
        for topic in topics:
            stage.bus.meddle[topic.key] = bus.shifted(by_s)

    return act


# Operator


def _operator() -> Iterator[Fault]:
    O = Group.OPERATOR  # noqa: E741
    yield Fault("clew_stop", O, "an operator stops it", Reaction.EASE, 0.15, _asks(Action.EASE))
    yield Fault("clew_hold", O, "an operator holds it", Reaction.HOLD, 0.15, _asks(Action.HOLD))
    yield Fault("clew_land", O, "an operator lands it", Reaction.LAND, 0.15, _asks(Action.LAND), watch_s=25.0)
    for moment in MOMENTS:
        name = f"clew_kill_in_{moment.phase}"
        yield Fault(name, O, f"an operator stops the motors in {moment.phase}", Reaction.DISARMED, 0.2, _asks(Action.KILL), moment, 3.0, family="clew kill",
                    exempt={"impact": "it falls", "tip_hand": "it falls", "tip_head": "it falls", "calm": "it falls"})  # fmt: skip
    yield Fault("clew_kill_without_supervisor", O, "an operator stops the motors, the supervisor dead", Reaction.DISARMED, 0.2, _kill_alone, watch_s=3.0,
                exempt={"impact": "it falls", "tip_hand": "it falls", "tip_head": "it falls", "calm": "it falls"})  # fmt: skip


def _asks(action: Action) -> Act:
    return lambda stage: stage.ask(action, 7)


def _kill_alone(stage: Stage) -> None:
    stage.kill("safety_supervisor")
    stage.ask(Action.KILL, 7)
