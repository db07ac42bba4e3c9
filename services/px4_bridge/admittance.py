"""The admittance filter: it turns the cable's pull and the guiding force into a motion of the robot's reference.

| paper | here | unit | frame |
|---|---|---|---|
| p_R, v_R, u_R of the filter | State.p, State.v, State.a | m, m/s, m/s² | W |
| M_A, B_A | M_A_kg, b_A_Ns_per_m | kg, N s/m | |
| K_H = diag(k_H, k_H, 0) | k_H_N_per_m | N/m | |
| f_c (on the handle; the robot feels -f_c) | f_c | N | W |
| u_A = K_H sat(p_R^d - p_R) + f^d | Command, u_A | N | W |

Source: the paper's admittance `u_R = M_A⁻¹(-B_A v_R - f_c + u_A)` with these additions: the spring acts on the
filter's own reference (G5b) and is saturated (G9); a small K_z and the handle's weight hold the height while nobody
holds the handle (G1, G6); more damping while free or slack (G6, G7); a ceiling (G6). All of them keep the filter
passive at (-f_c, v).

Discretisation: force and spring centre are held over dt, then each axis is M p̈ + b ṗ + k p = const, solved in closed
form, so a step of dt equals two of dt/2. Two switches are judged once per step, at its start: a saturated spring is a
constant force for that step (first order in dt, only while saturated), and the ceiling is applied at its end.
Broadcasts over leading axes.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from services.parameters import Positive, parameters
from services.physics import (
    Array,
    Components,
    Row,
    Scalar,
    anywhere,
    at_least,
    choose,
    clamp,
    components,
    scalar,
    vector,
)
from services.px4_bridge.response import respond

LONG_S = 1e3
RATIO_MIN, RATIO_MAX = 0.9, 2.0
EASE_SCALE = 0.2  # of the spring that keeps an eased robot in its place: 0.2 N at most


@parameters
class Admittance:
    """Virtual mass, dampings and springs of the filter."""

    M_A_kg: Positive
    b_A_Ns_per_m: Positive
    k_H_N_per_m: Positive
    k_z_N_per_m: Positive
    e_R_max_m: Positive
    b_free_Ns_per_m: Positive
    b_slack_Ns_per_m: Positive
    slack_keep_s: Positive


class State(NamedTuple):
    """Reference p, v, a = u_R, (..., 3), and the time since the cable was last slack in s, (...)."""

    p: Array
    v: Array
    a: Array
    taut_s: Scalar


class Command(NamedTuple):
    """What the filter is asked for; make it with `guide`, `wait`, `hold_height`, `ease` or `literal`."""

    p_d: Array  # centre of the springs in m, (..., 3)
    f_d: Array  # feed-forward force in N, (..., 3)
    scale: Scalar  # of everything horizontal in u_A, (...)
    k_z: float  # N/m
    k_xy: float  # N/m before the scale
    free: bool  # nobody holds the handle


def check(M_A_kg: float, m_R_kg: float) -> None:
    """Raise ValueError unless 0.9 <= M_A/m_R <= 2: below it the filter is delayed positive feedback (G5)."""
    if not RATIO_MIN <= M_A_kg / m_R_kg <= RATIO_MAX:
        raise ValueError(
            f"M_A_kg = {M_A_kg}: M_A/m_R = {M_A_kg / m_R_kg:.2f} with m_R_kg = {m_R_kg}, "
            f"must be between {RATIO_MIN} and {RATIO_MAX}"
        )


def engage(p_setpoint: Array) -> State:
    """The filter at rest at the last set-point sent (G9), (..., 3)."""
    zero = np.zeros_like(p_setpoint)
    return State(p_setpoint, zero, zero, scalar(np.full(p_setpoint.shape[:-1], LONG_S)))


def guide(p_R_d: Array, f_d: Array, scale: ArrayLike, p: Admittance) -> Command:
    """Phase 2, held: u_A = scale [K_H sat(p_R^d - p) + f_xy] + f_z z."""
    return _command(p_R_d, f_d, scale, k_z=0.0, k_xy=p.k_H_N_per_m, free=False)


def wait(p_anchor: Array, handle_weight_N: float, p: Admittance) -> Command:
    """Phase 1 (G1): stay at `p_anchor` with K_H and K_z and carry the hanging handle, until a hand takes it."""
    return _command(p_anchor, _up(p_anchor, handle_weight_N), 1.0, k_z=p.k_z_N_per_m, k_xy=p.k_H_N_per_m, free=True)


def hold_height(p_hold: Array, handle_weight_N: float, p: Admittance) -> Command:
    """Let go (G6): no horizontal force at all, height of `p_hold`, the hanging handle carried, more damping."""
    return _command(p_hold, _up(p_hold, handle_weight_N), 0.0, k_z=p.k_z_N_per_m, k_xy=p.k_H_N_per_m, free=True)


def ease(p_hold: Array, p: Admittance, *, anchored: bool = False) -> Command:
    """Back off: only a soft spring to the height of `p_hold`; a walking person drags the robot along at b_A.

    `anchored` adds a spring to its place, so weak that nobody feels it: for a `p_hold` that goes along with the hand.
    """
    return _command(
        p_hold,
        np.zeros_like(p_hold),
        EASE_SCALE if anchored else 0.0,
        k_z=p.k_z_N_per_m,
        k_xy=p.k_H_N_per_m,
        free=False,
    )


def literal(u_A: Array) -> Command:
    """The paper's form, for comparison (G5b): u_A comes from the ground, spring on the measured robot included."""
    return _command(u_A, u_A, 1.0, k_z=0.0, k_xy=0.0, free=False)


def u_A(p_ref: Array, c: Command, p: Admittance) -> Array:
    """u_A at reference `p_ref` in N, (..., 3)."""
    return vector(*Held(c, 0.0, p).u_A(components(p_ref))[0])


def damping(state: State, c: Command, p: Admittance) -> Row:
    """B_A by axes in N s/m, as it was in the step that led to `state`."""
    return _by_axes(Held(c, 0.0, p), state.taut_s)


def step(
    state: State, f_c: Array, c: Command, slack: Scalar, dt: Scalar, z_max_m: float, p: Admittance
) -> tuple[State, Array]:
    """Advance the filter by `dt` (s) under the cable force `f_c`; returns it and u_A at the new reference, (..., 3).

    `slack`: the cable is slack by motion capture; then, and for `slack_keep_s` after, z is damped more (G7).
    `z_max_m`: the ceiling, hand plane + l̄ + 0.1 m; a reference that starts above it may sink but not rise.
    """
    held = Held(c, dt, p)
    moved = move(state, f_c, held, slack, z_max_m)
    u, pull, v = held.u_A(components(moved.p))[0], components(f_c), components(moved.v)
    b = _by_axes(held, moved.taut_s)
    a = ((u_i - f - b_i * v_i) / p.M_A_kg for u_i, f, b_i, v_i in zip(u, pull, b, v, strict=True))
    return State(moved.p, moved.v, vector(*a), moved.taut_s), vector(*u)


Answer: TypeAlias = tuple[Scalar, Scalar, Scalar, Scalar]
"""Of an axis to a force f held over dt: p moves by `moved f + gained v` and v becomes `pushed f + kept v`.

In the order moved, gained, kept, pushed.
"""


class Held:
    """A command held over steps of `dt`: all of the filter that does not depend on its state.

    How an axis answers a force depends on whether the spring is saturated, hence
    a constant force, and whether the axis is damped more. Each case is worked out when it first occurs and kept, so
    that a crowd whose command stays for some steps pays once.
    """

    def __init__(self, c: Command, dt: Scalar, p: Admittance, before: "Held | None" = None) -> None:
        """`before` is the command that was held until now, for the same `p`; what can be kept of it is kept."""
        f_x, f_y, f_z = components(c.f_d)
        self.dt, self.p = dt, p
        self._p_d, self._f = components(c.p_d), (c.scale * f_x, c.scale * f_y, f_z)
        self._k_xy, self._k_z, self._free = c.scale * c.k_xy, c.k_z, c.free
        self._most_xy, self._most_z = self._k_xy * p.e_R_max_m, c.k_z * p.e_R_max_m
        self._known: dict[tuple[bool, bool, bool], Answer] = {}
        if before is not None and before._answers_as(self):
            self._known = before._known

    def _answers_as(self, other: "Held") -> bool:
        alike = self.dt == other.dt and self._k_z == other._k_z and self._free == other._free
        return alike and np.array_equal(self._k_xy, other._k_xy)

    def u_A(self, p_ref: Components) -> tuple[Row, tuple[Scalar, Scalar]]:
        """u_A at `p_ref` in N by axes, and whether the springs of the plane and of z are saturated."""
        (x, y, z), (x_d, y_d, z_d), (f_x, f_y, f_z) = p_ref, self._p_d, self._f
        e_x, e_y = x_d - x, y_d - y
        along, flat = _spring((e_x * e_x + e_y * e_y) ** 0.5, self._most_xy, self.p)
        if not self._k_z:
            return (along * e_x + f_x, along * e_y + f_y, f_z), (flat, False)
        up, upright = _spring(abs(z_d - z), self._most_z, self.p)
        return (along * e_x + f_x, along * e_y + f_y, up * (z_d - z) + f_z), (flat, upright)

    def damping(self, more: Scalar) -> Scalar:
        """b in N s/m; `more` for z while the cable is slack."""
        b = self.p.b_free_Ns_per_m if self._free else self.p.b_A_Ns_per_m
        return choose(more, at_least(b, self.p.b_slack_Ns_per_m), b)

    def xy(self, saturated: Scalar) -> Answer:
        """Of x and of y."""
        if type(saturated) is bool:
            return self._case(False, saturated, False)
        return _either(saturated, lambda: self._case(False, True, False), lambda: self._case(False, False, False))

    def z(self, saturated: Scalar, damped: Scalar) -> Answer:
        """Of z."""
        if type(saturated) is bool and type(damped) is bool:
            return self._case(True, saturated, damped)
        return _either(
            saturated,
            lambda: _either(damped, lambda: self._case(True, True, True), lambda: self._case(True, True, False)),
            lambda: _either(damped, lambda: self._case(True, False, True), lambda: self._case(True, False, False)),
        )

    def _case(self, up: bool, saturated: bool, damped: bool) -> Answer:
        case, M_A = (up, saturated, damped), self.p.M_A_kg
        if case not in self._known:
            k = 0.0 if saturated else self._k_z if up else self._k_xy
            moved, gained, kept = respond(0.5 * self.damping(damped) / M_A, k / M_A, self.dt)
            self._known[case] = moved / M_A, gained, kept, gained / M_A
        return self._known[case]


class Moved(NamedTuple):
    """A State without its acceleration."""

    p: Array
    v: Array
    taut_s: Scalar


def move(state: State | Moved, f_c: Array, held: Held, slack: Scalar, z_max_m: Scalar) -> Moved:
    """The motion of `step`, for whoever needs no acceleration."""
    taut_s = choose(slack, 0.0, state.taut_s + held.dt)
    before, (x, y, z) = components(state.p), components(f_c)
    (u_x, u_y, u_z), (flat, upright) = held.u_A(before)
    xy, up = held.xy(flat), held.z(upright, taut_s < held.p.slack_keep_s)
    position, velocity = list[Scalar](), list[Scalar]()
    for (moved, gained, kept, pushed), p_i, v, force in zip(
        (xy, xy, up), before, components(state.v), (u_x - x, u_y - y, u_z - z), strict=True
    ):
        position.append(p_i + gained * v + moved * force)
        velocity.append(kept * v + pushed * force)
    position[2], velocity[2] = _under_ceiling(position[2], velocity[2], before[2], z_max_m)
    return Moved(vector(*position), vector(*velocity), taut_s)


def _either(flag: Scalar, if_so: Callable[[], Answer], if_not: Callable[[], Answer]) -> Answer:
    """As `choose`, with only what is chosen by anybody worked out."""
    if not anywhere(flag):
        return if_not()
    if type(flag) is bool:
        return if_so()
    yes_and_no = zip(if_so(), if_not(), strict=True)
    moved, gained, kept, pushed = (choose(flag, yes, no) for yes, no in yes_and_no)
    return moved, gained, kept, pushed


def _by_axes(held: Held, taut_s: Scalar) -> Row:
    """b in N s/m: z is damped more for a while after the cable was slack (G7)."""
    b = held.damping(False)
    return b, b, held.damping(taut_s < held.p.slack_keep_s)


def _spring(length: Scalar, most_N: Scalar, p: Admittance) -> tuple[Scalar, Scalar]:
    """Force per length in N/m of the spring whose force is at most `most_N`, and whether it is that."""
    return most_N / at_least(length, p.e_R_max_m), length > p.e_R_max_m


def _under_ceiling(z: Scalar, v: Scalar, before: Scalar, z_max: Scalar) -> tuple[Scalar, Scalar]:
    """Stop a rise above `z_max` from where it was `before`; what is taken is kinetic energy, so the filter stays passive."""
    if not anywhere(z > z_max):
        return z, v
    z_max = at_least(before, z_max)
    risen = z > z_max
    return choose(risen, z_max, z), choose(risen, clamp(v, -np.inf, 0.0), v)


def _up(like: Array, force_N: float) -> Array:
    force = np.zeros_like(like)
    force[..., 2] = force_N
    return force


def _command(p_d: Array, f_d: Array, scale: ArrayLike, *, k_z: float, k_xy: float, free: bool) -> Command:
    return Command(p_d, f_d, scalar(np.asarray(scale, dtype=np.float64)), k_z, k_xy, free)
