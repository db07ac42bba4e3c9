"""Motion capture, thrust and the inertial sensor, wrong in ways that messages do not show."""

from collections.abc import Callable, Iterator
from typing import Any

from schemas.topics import MOCAP_FRAME
from services.faults.fault import Fault, Group, Reaction
from services.faults.promises import FORCE_N
from services.faults.rows.common import SINKS, Act, later
from services.rehearsal import meddled_bus as bus
from services.rehearsal.chain import Stage
from services.rehearsal.rehearsed_vehicle import Messages


def sensing() -> Iterator[Fault]:
    """The rows of this module."""
    S = Group.SENSING
    yield Fault(
        "handle_hidden", S, "the handle is occluded for 3 s", Reaction.ANY, 0.0, _frames(_hidden("handle")), watch_s=6.0
    )
    for axis, by_m in (("x", 0.5), ("x", -0.5), ("y", 0.5), ("z", 0.5)):
        side = f"{'minus' if by_m < 0 else 'plus'}_{axis}"
        about = f"the handle's marker set jumps by {by_m:+.1f} m along {axis}"
        yield Fault(
            f"handle_jumps_{side}", S, about, Reaction.EASE, 0.4, _frames(_jump("handle", axis, by_m)), watch_s=6.0,
            family="handle jumps",
        )  # fmt: skip
    for by_mps, within_s in ((0.1, 1.2), (0.2, 0.8), (0.5, 0.6), (-0.2, 1.2)):
        way = "up" if by_mps > 0 else "down"
        yield Fault(
            f"handle_creeps_{way}_{abs(by_mps):g}".replace(".", "_"), S,
            f"the handle's marker set creeps {way} at {abs(by_mps):g} m/s", Reaction.EASE, within_s,
            _creeps(by_mps), watch_s=7.0, pull_max_N=FORCE_N, family="handle creeps",
        )  # fmt: skip
    yield Fault("robot_lost", S, "motion capture loses the vehicle", Reaction.LAND, 3.0, _frames(_hidden("robot")), watch_s=9.0,
                exempt=SINKS)  # fmt: skip
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
        Reaction.ANY,
        0.0,
        _thrust(lambda t: 0.2),
        watch_s=5.0,
    )
    yield Fault(
        "thrust_20_percent_low",
        S,
        "the motors push 20 % more than they are believed to",
        Reaction.ANY,
        0.0,
        _thrust(lambda t: -0.2),
        watch_s=5.0,
    )
    yield Fault(
        "imu_stuck", S, "the inertial sensor says the same for ever", Reaction.EASE, 0.4, _imu_stuck, watch_s=5.0
    )


Body = dict[str, Any]
IDLE_us = 1000.0  # of the motors' outputs


def _frames(how: Callable[[dict[str, Any]], dict[str, Any]], for_s: float = 3.0) -> Act:
    def act(stage: Stage) -> None:
        stage.bus.meddle[MOCAP_FRAME.key] = bus.changed(how)
        later(for_s, lambda: stage.bus.meddle.pop(MOCAP_FRAME.key, None))

    return act


def _hidden(body: str) -> Callable[[Body], Body]:
    return lambda frame: frame | {body: frame[body] | {"tracked": False}}


def _jump(body: str, axis: str, by_m: float) -> Callable[[Body], Body]:
    def move(frame: Body) -> Body:
        p = frame[body]["position_m"]
        return frame | {body: frame[body] | {"position_m": p | {axis: p[axis] + by_m}}}

    return move


def _creeps(by_mps: float) -> Act:
    """For 3 s, and back at once."""

    def act(stage: Stage) -> None:
        begin_s = stage.now_s
        _frames(lambda frame: _jump("handle", "z", by_mps * (stage.now_s - begin_s))(frame))(stage)

    return act


def _exchanged(frame: Body) -> Body:
    return frame | {"handle": frame["robot"], "robot": frame["handle"]}


def _thrust(error: Callable[[float], float]) -> Act:
    """The motors' reported use is wrong by that share, `t` s after the fault began."""

    def act(stage: Stage) -> None:
        begin_s = stage.now_s

        def garble(messages: Messages) -> Messages:
            factor = 1.0 + error(stage.now_s - begin_s)
            return [
                (name, {**fields, "actuator": [IDLE_us + factor * (u - IDLE_us) for u in fields["actuator"]]})
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
