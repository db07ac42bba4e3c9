"""The walk in a recording: where hand and robot were, what the cable pulled, and which part was guided."""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.safety import Phase
from schemas.topics import CABLE_FORCE, HANDLE_STATE, SAFETY_STATE, TRUTH, VEHICLE_STATE
from services.guiding_controller import path_file
from services.guiding_controller.path import Path
from services.physics import Array, norm
from services.recorder.reading import Interval, Session
from services.recorder.table import Table, sample

CONFIG_ATTACHMENT = "config.json"
NO_PHASE_2 = "nobody was guided: it has no phase 2"
_SLACK_N = 0.01


@dataclass(frozen=True, eq=False)
class Motion:
    """Samples of the whole session: t_s (T,), p_H, p_R, f_c and the force on the hand (T, 3), slack and held (T,).

    From the simulator's truth where there is one (`from_truth`), else from motion capture and the estimated force.
    """

    t_s: Array
    p_H: Array
    p_R: Array
    f_c: Array
    f_hand: Array
    slack: NDArray[np.bool_]
    held: NDArray[np.bool_]
    from_truth: bool

    def during(self, spans: list[Interval]) -> NDArray[np.bool_]:
        """Which samples fall into any of the spans."""
        return within(self.t_s, spans)


def elsewhere(session: Session) -> set[str]:
    """The services of the other host, where there are two."""
    config = config_of(session)
    here = config.get("system", {}).get("host")
    return {name for host, each in config.get("hosts", {}).items() if host != here for name in each["services"]}


def motion(session: Session) -> Motion:
    """What is known best of the motion in a recording; of length 0 where nothing is."""
    truth = session.table(TRUTH)
    return _true_motion(truth) if len(truth["t_s"]) else _seen_motion(session)


def _true_motion(truth: Table) -> Motion:
    f_c = truth["cable_force_N"]
    return Motion(
        t_s=truth["t_s"],
        p_H=truth["handle_position_m"],
        p_R=truth["robot_position_m"],
        f_c=f_c,
        f_hand=truth["hand_force_N"],
        slack=norm(f_c) < _SLACK_N,
        held=truth["holding"],
        from_truth=True,
    )


def _seen_motion(session: Session) -> Motion:
    """On the times of motion capture; the force on the hand is the cable's, its handle's weight included."""
    handle, cable, safety = (valid(session.table(topic)) for topic in (HANDLE_STATE, CABLE_FORCE, SAFETY_STATE))
    vehicle = valid(session.table(VEHICLE_STATE))
    t_s = handle["t_s"] if all(len(table["t_s"]) for table in (cable, safety, vehicle)) else np.zeros(0)
    f_c = at(cable, "force_N", t_s)
    held = at(safety, "held", t_s) > 0.5
    return Motion(
        t_s=t_s,
        p_H=handle["position_m"][: len(t_s)],
        p_R=at(vehicle, "position_m", t_s),
        f_c=f_c,
        f_hand=f_c * held[:, None],
        slack=at(cable, "taut", t_s) < 0.5,
        held=held,
        from_truth=False,
    )


def guided(session: Session) -> list[Interval]:
    """Phase 2: every stay in the phase `guiding`."""
    return [interval for interval in session.phases if interval.phase is Phase.GUIDING]


def within(t_s: Array, spans: list[Interval]) -> NDArray[np.bool_]:
    """Which times (T,) fall into any of the spans."""
    inside = np.zeros(t_s.shape, np.bool_)
    for span in spans:
        inside |= (t_s >= span.start_s) & (t_s < span.end_s)
    return inside


def valid(table: Table) -> Table:
    """Only the messages that said of themselves that they can be trusted."""
    return {name: column[table["valid"]] for name, column in table.items()}


def at(table: Table, column: str, t_s: Array) -> Array:
    """A column at other times (M,), (M, ...), linear between its samples; the table may be empty only if `t_s` is."""
    values = np.asarray(table[column], np.float64)
    return sample(table["t_s"], values, t_s) if len(t_s) else np.zeros((0, *values.shape[1:]))


def config_of(session: Session) -> dict[str, Any]:
    """The configuration that was recorded, as it was written; empty where it is missing."""
    return json.loads(session.attachments.get(CONFIG_ATTACHMENT, b"{}"))


def path_of(session: Session) -> Path | None:
    """The path that was guided along, from the recording's own copy; None where it has none."""
    config = config_of(session)
    return path_file.build(config["path"], config["world"]["hand_height_m"]) if "path" in config else None
