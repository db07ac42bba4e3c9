"""The person on the cable: the paper's mass and damper on the plane of the hand, with a scripted will.

| paper | here | unit | frame |
|---|---|---|---|
| p_H, v_H | p_H_W, v_H_W | m, m/s | W |
| m_H, B_H = b_H I | m_H_kg, b_H_Ns_per_m | kg, N s/m | |
| f_c, u_H | f_c_W, u_H_W | N | W |
| z = 0, the plane of the hand | hand_height_m above the floor | m | |

Source: humanModel; the ground's force f_g keeps the height of the hand, which asks for f_c·z < m_H g. A script is data: a
tuple of events, and `u_H` reads it as a pure function of time. The head is what the rotors must stay clear of (G10).
Everything broadcasts over leading axes.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np
from annotated_types import Gt

from services.parameters import NonNegative, Positive, parameters
from services.physics import Array, Scalar, anywhere, at_least, choose, components, exp, vector

_XY = np.array([1.0, 1.0, 0.0])
_TURNING_SPEED_MPS = 0.1  # slower than this a person does not turn towards where the hand moves


@parameters
class Human:
    """Inertia and damping of the walking person at the hand, and where the head is: behind the hand, above the floor."""

    m_H_kg: Positive
    b_H_Ns_per_m: Positive
    hand_height_m: Positive
    head_height_m: Positive
    head_behind_hand_m: NonNegative
    head_beside_hand_m: float
    turning_time_s: Positive
    b_stop_Ns_per_m: Positive
    reaction: Annotated[float, Gt(-1)] = 0.0
    """Own force per pull felt: above 0 the person steps along, below 0 they hang back."""
    pull_threshold_N: NonNegative = 0.0
    """A pull up to this is leant against, and only what is more is followed."""
    veer: float = 0.0
    """Part of the pull that the person adds to its left: they walk at an angle to it."""


class HumanState(NamedTuple):
    """Hand position and velocity, and the direction the person faces (horizontal, unit length), each (..., 3)."""

    p_H_W: Array
    v_H_W: Array
    facing_W: Array


class Kind(StrEnum):
    """What a person can do of their own will."""

    STOP = "stop"  # digs the heels in: strong damping
    PUSH = "push"  # a force
    WALK_AWAY = "walk_away"  # a force, meant to last
    LET_GO = "let_go"  # opens the hand
    RAISE = "raise"  # moves the hand up, or down, from its height
    PULL_DOWN = "pull_down"  # a force downwards on whatever resists, until the arm is stretched


@dataclass(frozen=True, kw_only=True)
class Event:
    """One deed: from `start_s` for `duration_s`, with what its kind asks for: a horizontal force, or a height and a speed.

    Of a crowd each number is an array (...); who does nothing of the kind starts at infinity.
    """

    kind: Kind
    start_s: float
    duration_s: float = math.inf
    force_W_N: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rise_m: float = 0.0
    speed_mps: float = 0.5

    def __post_init__(self) -> None:
        """Refuse what cannot be meant. Raises ValueError."""
        if not np.all(np.asarray(self.duration_s) > 0.0):
            raise ValueError(f"{self.kind}.duration_s = {self.duration_s} must be above 0")
        if self.kind in (Kind.PUSH, Kind.WALK_AWAY) and not any(np.any(f) for f in self.force_W_N[:2]):
            raise ValueError(f"{self.kind}.force_W_N = {self.force_W_N} must have a horizontal part")
        if self.kind is Kind.PULL_DOWN and not (self.force_W_N[2] < 0.0 and self.rise_m < 0.0):
            raise ValueError(f"{self.kind}: force_W_N[2] and rise_m, how far the arm goes, must be below 0")
        if not self.speed_mps > 0.0:
            raise ValueError(f"{self.kind}.speed_mps = {self.speed_mps} must be above 0")

    def covers(self, t_s: float) -> Scalar:
        """Whether the event is going on at `t_s`: a bool, of a crowd (...) of them."""
        return (self.start_s <= t_s) & (t_s < self.start_s + self.duration_s)


Behaviour = tuple[Event, ...]


def u_H(t_s: float, state: HumanState, script: Behaviour, p: Human) -> Array:
    """The person's own force at time `t_s` in N, (..., 3), horizontal."""
    total = 0.0 * state.v_H_W
    for event in script:
        now = event.covers(t_s)
        if anywhere(now):
            total = total + _deed(event, state, p) * np.asarray(now)[..., None]
    return total * _XY


def lean(f_c_W: Array, p: Human) -> Array:
    """The person's own force in answer to the pull, (..., 3) N, horizontal: reaction, threshold and veer."""
    x, y, _ = components(f_c_W)
    over = at_least(1.0 - p.pull_threshold_N / at_least((x * x + y * y) ** 0.5, 1e-9), 0.0)
    follow = (1.0 + p.reaction) * over
    return vector(follow * (x - p.veer * y) - x, follow * (y + p.veer * x) - y, 0.0 * x)


def lets_go(t_s: float, script: Behaviour) -> bool:
    """Whether the script opens the hand at `t_s`."""
    return any(event.kind is Kind.LET_GO and event.covers(t_s) for event in script)


def rise(t_s: float, script: Behaviour) -> tuple[float, float]:
    """How far above its height the script wants the hand at `t_s` in m, and how fast it goes there in m/s (0: no wish)."""
    for event in script:
        if event.kind is Kind.RAISE and event.covers(t_s):
            return event.rise_m, event.speed_mps
    return 0.0, 0.0


def pull_down(t_s: float, script: Behaviour) -> tuple[float, float]:
    """With how many N the script pulls the hand down at `t_s`, and how far below its height the arm is stretched, m."""
    for event in script:
        if event.kind is Kind.PULL_DOWN and event.covers(t_s):
            return -event.force_W_N[2], -event.rise_m
    return 0.0, 0.0


def _deed(event: Event, state: HumanState, p: Human) -> Array:
    if event.kind is Kind.STOP:
        return vector(*(-p.b_stop_Ns_per_m * v for v in components(state.v_H_W)))
    return vector(*event.force_W_N)


def step(state: HumanState, f_c_W: Array, u_H_W: Array, dt: float, p: Human) -> HumanState:
    """One step of `m_H v̇_H = -b_H v_H + f_c + u_H` in the plane; exact for forces held over `dt` (humanModel).

    `f_c_W` and `u_H_W` are (..., 3) N; the height of the hand stays as it is.
    """
    p_H, v = moved(state.p_H_W, state.v_H_W, f_c_W + u_H_W, response(dt, p))
    return HumanState(p_H, v, facing(state.facing_W, v, dt, p))


Response: TypeAlias = tuple[Scalar, Scalar, Scalar, Scalar]
"""What a person makes of a force f held over dt: p moves by `glide v + shift f` and v becomes `kept v + push f`.

In the order glide in s, kept, shift in m/N, push in m/s/N.
"""


def response(dt: float, p: Human) -> Response:
    """Of the exact solution of humanModel over `dt` s, all that does not depend on the state."""
    b, rate = p.b_H_Ns_per_m, p.b_H_Ns_per_m / p.m_H_kg
    kept = exp(-rate * dt)
    glide = (1.0 - kept) / rate
    return glide, kept, (dt - glide) / b, (1.0 - kept) / b


def moved(p_H_W: Array, v_H_W: Array, force_W: Array, r: Response) -> tuple[Array, Array]:
    """Hand and its velocity after the step of `r` under `force_W` = f_c + u_H in N, each (..., 3)."""
    (x, y, z), (v_x, v_y, _), (f_x, f_y, _) = components(p_H_W), components(v_H_W), components(force_W)
    glide, kept, shift, push = r
    p_H = vector(x + glide * v_x + shift * f_x, y + glide * v_y + shift * f_y, z)
    return p_H, vector(kept * v_x + push * f_x, kept * v_y + push * f_y, 0.0 * z)


def facing(facing_W: Array, v_W: Array, dt: float, p: Human) -> Array:
    """The person turns towards the way the hand moves, within about `turning_time_s`; unit length, (..., 3)."""
    (x, y, _), (v_x, v_y, _) = components(facing_W), components(v_W)
    speed = (v_x * v_x + v_y * v_y) ** 0.5
    gain = choose(speed > _TURNING_SPEED_MPS, 1.0 - exp(-dt / p.turning_time_s), 0.0)
    per_speed = 1.0 / at_least(speed, _TURNING_SPEED_MPS)
    turned_x = x + gain * (v_x * per_speed - 0.01 * y - x)  # the little to the left: for who moves straight back
    turned_y = y + gain * (v_y * per_speed + 0.01 * x - y)
    length = (turned_x * turned_x + turned_y * turned_y) ** 0.5
    return vector(turned_x / length, turned_y / length, 0.0 * length)


def head(p_H_W: Array, facing_W: Array, p: Human) -> Array:
    """Where the head is, (..., 3) m in the world: behind the hand, to its left by `head_beside_hand_m`, at its height."""
    (x, y, _), (ahead_x, ahead_y, _) = components(p_H_W), components(facing_W)
    behind, beside = p.head_behind_hand_m, p.head_beside_hand_m
    height = p.head_height_m + 0.0 * x
    return vector(x - behind * ahead_x - beside * ahead_y, y - behind * ahead_y + beside * ahead_x, height)
