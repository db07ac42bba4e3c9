"""Between the hand and the end of the cable: near enough for the cable to hang slack, far enough for the propellers.

| here | meaning | unit | frame |
|---|---|---|---|
| p, v | the reference | m, m/s | W |
| p_H, v_H | the hand, as motion capture sees the handle | m, m/s | W |

Both limits are spheres round the hand. The outer one (l̄ less the slack) keeps the cable of a vehicle slack that is not to pull,
and takes it along with a person who walks on. The inner one acts in every way of flying: a hand that is lifted pushes the
reference ahead of it. Both move it at the hand's own speed; where a filter moves it, the inner one is a force on that.
Vectors are (3,): one vehicle, one hand.
"""

from typing import NamedTuple

from services.physics import Array, Components, Scalar, at_least, clamp, components, vector

RETURN_PER_S = 8.0  # of what is missing to the inner sphere, or too much for the outer one
FASTEST_MPS = 1.2
PUSH_N_PER_M, PUSH_NS_PER_M, PUSH_MAX_N = 150.0, 15.0, 20.0


class Hand(NamedTuple):
    """p_H in m and v_H in m/s, (3,)."""

    p: Array
    v: Array


def between(p: Array, p_H: Array, near_m: float, far_m: float) -> Array:
    """The place nearest to `p` that is no nearer to the hand than `near_m` and no further than `far_m`."""
    away, distance = _from(components(p_H), components(p))
    wanted = clamp(distance, near_m, far_m)
    return vector(*(h + wanted * a for h, a in zip(components(p_H), away, strict=True)))


def push(p: Array, v: Array, hand: Hand, near_m: float) -> Array:
    """The force in N with which a hand within `near_m` pushes a filter's reference: a spring and a damper between them."""
    away, distance = _from(components(hand.p), components(p))
    closing = _dot(away, hand.v) - _dot(away, v)
    force = (
        clamp(PUSH_N_PER_M * (near_m - distance) + PUSH_NS_PER_M * closing, 0.0, PUSH_MAX_N)
        if distance < near_m
        else 0.0
    )
    return vector(*(force * a for a in away))


def pushed(p: Array, v: Array, hand: Hand, dt: float, near_m: float) -> tuple[Array, Array]:
    """The reference after `dt` s in which a hand within `near_m` has pushed it ahead; as it was where none is."""
    away, distance = _from(components(hand.p), components(p))
    if distance >= near_m:
        return p, v
    least = clamp(_dot(away, hand.v) + RETURN_PER_S * (near_m - distance), 0.0, FASTEST_MPS)
    return _faster(p, v, away, at_least(least - _dot(away, v), 0.0), dt)


def led(p: Array, v: Array, hand: Hand, dt: float, far_m: float) -> tuple[Array, Array]:
    """The reference after `dt` s in which a hand further than `far_m` has taken it along; as it was where none is."""
    away, distance = _from(components(hand.p), components(p))
    if distance <= far_m:
        return p, v
    most = clamp(_dot(away, hand.v) + RETURN_PER_S * (far_m - distance), -FASTEST_MPS, 0.0)
    return _faster(p, v, away, -at_least(_dot(away, v) - most, 0.0), dt)


def _faster(p: Array, v: Array, away: Components, by_mps: Scalar, dt: float) -> tuple[Array, Array]:
    """Both, as if the reference had moved faster by that much during the `dt` that is over."""
    moved = (x + by_mps * dt * a for x, a in zip(components(p), away, strict=True))
    return vector(*moved), vector(*(x + by_mps * a for x, a in zip(components(v), away, strict=True)))


def _dot(away: Components, v: Array) -> Scalar:
    return sum(a * x for a, x in zip(away, components(v), strict=True))


def _from(hand: Components, p: Components) -> tuple[Components, float]:
    """Unit vector from the hand to `p`, upwards where they coincide, and their distance."""
    x, y, z = (b - a for a, b in zip(hand, p, strict=True))
    distance = float((x * x + y * y + z * z) ** 0.5)
    if distance < 1e-6:
        return (0.0, 0.0, 1.0), distance
    return (x / distance, y / distance, z / distance), distance
