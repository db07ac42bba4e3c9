"""The guided walk, phase 2 of the experiment, for one person or for a crowd at once, by the laws that fly.

| paper | here | unit | frame |
|---|---|---|---|
| p_H, p_R | Walks.p_H, Walks.p_R | m | W |
| s* | Walks.s | | |
| f_c | its largest size, Walks.force_max_N | N | |

Physics at 1 kHz: cable.force, the robot (with the ideal one admittance.step's motion) and human.step's. At 100 Hz:
guiding.step with the exact projection, the radio's delay, the person's will (human.u_H, human.lean), whether the cable is
slack. Everything broadcasts: a crowd's parameters and states have the leading axis (n,), one person's have none and
run on plain floats. The largest force is looked for at 100 Hz, places are kept at 20 Hz.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from services import cable
from services.cable import Cable
from services.campaign.robot import STEP_S, Robot
from services.guiding_controller import guiding
from services.guiding_controller.guiding import Guidance, Guiding
from services.guiding_controller.path import Path
from services.physics import Array, Scalar, Z, norm, scalar, vector
from services.px4_bridge import admittance
from services.px4_bridge.admittance import Admittance, Command
from services.simulator import human
from services.simulator.human import Behaviour, Human

CONTROL_S = 0.01
KEPT_S = 0.05
STEPS = round(CONTROL_S / STEP_S)
KEPT_TICKS = round(KEPT_S / CONTROL_S)


class Controller(StrEnum):
    """Which of the method's forms guides."""

    REFERENCE = "reference"  # maneuver regulation with the spring on the filter's own reference (G5b): what flies
    LITERAL = "literal"  # maneuver regulation as printed: u_A from the ground, spring on the robot
    REGULATION = "regulation"  # straight to the end of the path


@dataclass(frozen=True, kw_only=True, eq=False)
class People:
    """Who walks: their bodies, what they do of their own will, and how far left of the path each one starts, (...) m."""

    human: Human
    behaviour: Behaviour
    start_aside_m: Scalar


@dataclass(frozen=True, kw_only=True, eq=False)
class Experiment:
    """What they walk with. Scalars of the parameters may be (...), one for each person."""

    path: Path
    cable: Cable
    guiding: Guiding
    filter: Admittance
    ceiling_above_hand_m: float
    slack_margin_m: float
    controller: Controller
    delay_ticks: Scalar  # whole control ticks from the hand's place to the command that follows from it


class Walks(NamedTuple):
    """t_s (T,), positions (..., T, 3), s* (..., T); and of each walk the extremes (...)."""

    t_s: Array
    p_H: Array
    p_R: Array
    s: Array
    force_max_N: Array
    head_min_m: Array


def start(who: People, x: Experiment) -> tuple[Array, Array]:
    """Hand and robot at the start, (..., 3) m: the robot over the hand, the cable straight but not yet taut."""
    p_H = x.path.p(0.0) + np.asarray(who.start_aside_m)[..., None] * x.path.normal(0.0)
    height = who.human.hand_height_m
    p_H = vector(*(p_H[..., i] + 0.0 * height for i in (0, 1)), height + 0.0 * p_H[..., 0])
    return p_H, p_H + np.asarray(x.cable.rest_length_m)[..., None] * Z


def walk(
    who: People, x: Experiment, robot: Robot, duration_s: float, progress: Callable[[float], None] = lambda _: None
) -> Walks:
    """Guide `who` for `duration_s`; the robot must be the one that `start` placed. `progress` is told of each second."""
    kept = _Kept(robot.p_W.shape[:-1], round(duration_s / CONTROL_S))
    for tick, p_H, s, f_c, facing in _ticks(who, x, robot, round(duration_s / CONTROL_S)):
        kept.feel(f_c)
        if tick % KEPT_TICKS == 0:
            kept.look(tick // KEPT_TICKS, p_H, robot.p_W, s, human.head(p_H, facing, who.human))
        if (tick + 1) * CONTROL_S % 1.0 < 0.5 * CONTROL_S:
            progress(1.0)
    return kept.walks()


def _ticks(who: People, x: Experiment, robot: Robot, count: int) -> Iterator[tuple[int, Array, Scalar, Array, Array]]:
    """Each control tick before it acts: its number, p_H, s*, f_c and where the person faces."""
    p_H, _ = start(who, x)
    v_H, facing = np.zeros_like(p_H), np.broadcast_to(x.path.t_hat(0.0), p_H.shape)
    state, body = guiding.start(p_H, x.path), human.response(STEP_S, who.human)
    radio = _Radio(x.delay_ticks, p_H.shape[:-1])
    f_c = cable.force(robot.p_W, p_H, robot.v_W, v_H, x.cable)
    for tick in range(count):
        yield tick, p_H, state.s, f_c, facing
        told = guiding.Input(p_H, robot.p_W, held=True, guiding=True)
        state, wanted = guiding.step(state, told, CONTROL_S, x.path, x.guiding, x.cable)
        slack = scalar(norm(robot.p_W - p_H) < x.cable.rest_length_m - x.slack_margin_m)
        robot.obey(_command(radio.pass_on(tick, wanted), x), slack)
        person = human.HumanState(p_H, v_H, facing)
        will = human.u_H(tick * CONTROL_S, person, who.behaviour, who.human) + human.lean(f_c, who.human)
        for _ in range(STEPS):
            robot.step(f_c)
            p_H, v_H = human.moved(p_H, v_H, f_c + will, body)
            f_c = cable.force(robot.p_W, p_H, robot.v_W, v_H, x.cable)
        facing = human.facing(facing, v_H, CONTROL_S, who.human)


def _command(g: Guidance, x: Experiment) -> Command:
    match x.controller:
        case Controller.REFERENCE:
            return admittance.guide(g.p_R_d, g.f_d, g.scale, x.filter)
        case Controller.LITERAL:
            return admittance.literal(g.u_A)
        case Controller.REGULATION:
            f_z = np.asarray(x.guiding.f_z_N)[..., None] * Z + 0.0 * g.f_d
            return admittance.guide(x.path.p(1.0) + cable.offset(f_z, x.cable), f_z, g.scale, x.filter)


class _Radio:
    """What guidance says, some ticks late; until the first word has come through, the first word."""

    def __init__(self, delay_ticks: Scalar, shape: tuple[int, ...]) -> None:
        self._delay = np.broadcast_to(np.asarray(delay_ticks, dtype=np.int64), shape)
        self._said = np.empty((int(np.max(self._delay)) + 1, 10, *shape))

    def pass_on(self, tick: int, g: Guidance) -> Guidance:
        """The guidance that arrives now."""
        length = len(self._said)
        if length == 1:
            return g
        parts = (*np.moveaxis(g.p_R_d, -1, 0), *np.moveaxis(g.f_d, -1, 0), *np.moveaxis(g.u_A, -1, 0), g.scale)
        for i, part in enumerate(parts):
            self._said[tick % length, i] = part
        which = np.maximum(tick - self._delay, 0) % length
        heard = np.take_along_axis(self._said, np.broadcast_to(which, (1, *self._said.shape[1:])), axis=0)[0]
        vectors = (vector(*(scalar(part) for part in heard[i : i + 3])) for i in (0, 3, 6))
        p_R_d, f_d, u_A = vectors
        return g._replace(p_R_d=p_R_d, f_d=f_d, u_A=u_A, scale=scalar(heard[9]))


class _Kept:
    """What is remembered of the walks."""

    def __init__(self, shape: tuple[int, ...], ticks: int) -> None:
        self._places = np.empty(((ticks - 1) // KEPT_TICKS + 1, 7, *shape))
        self._force2, self._head2 = np.zeros(shape), np.full(shape, np.inf)

    def feel(self, f_c: Array) -> None:
        """The pull on the hand, at every control tick."""
        self._force2 = np.maximum(self._force2, _squared(f_c))

    def look(self, i: int, p_H: Array, p_R: Array, s: Scalar, p_head: Array) -> None:
        """Where everything is, for the i-th time."""
        self._head2 = np.minimum(self._head2, _squared(p_R - p_head))
        row = self._places[i]
        row[:3], row[3:6], row[6] = np.moveaxis(p_H, -1, 0), np.moveaxis(p_R, -1, 0), s

    def walks(self) -> Walks:
        """All of it."""
        places = np.moveaxis(self._places, (0, 1), (-2, -1))
        t_s = np.arange(places.shape[-2], dtype=np.float64) * KEPT_S
        p_H, p_R, s = places[..., :3], places[..., 3:6], places[..., 6]
        return Walks(t_s, p_H, p_R, s, np.sqrt(self._force2), np.sqrt(self._head2))


def _squared(v: Array) -> Array:
    x, y, z = (v[..., i] for i in range(3))
    return x * x + y * y + z * z
