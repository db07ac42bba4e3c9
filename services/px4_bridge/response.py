"""What a spring, a damper and a mass do under a force that is held: the closed form, at every damping ratio.

| paper | here | unit |
|---|---|---|
| b/(2 M), k/M of an axis | a, w2 | 1/s, 1/s² |

Exact, so two steps of dt/2 are one of dt. Broadcasts.
"""

import math

import numpy as np

from services.physics import Row, Scalar, choose


def respond(a: Scalar, w2: Scalar, dt: Scalar) -> Row:
    """δ̈ + 2a δ̇ + w² δ = u from δ = 0: δ = moved u + gained v, δ̇ = gained u + kept v; exact, every damping ratio."""
    cosine, sine = _decaying(a * dt, (a * a - w2) * dt * dt)
    gained = sine * dt
    kept = cosine - a * gained
    stiff = w2 * dt * dt > 1e-8  # below, both forms agree to 1e-8 and the first loses digits
    moved = choose(stiff, 1.0 - cosine - a * gained, dt - gained) / choose(stiff, w2, 2.0 * a)
    return moved, gained, kept


def _decaying(decay: Scalar, z: Scalar) -> tuple[Scalar, Scalar]:
    """cosh √z and sinh √z/√z, which are cos √-z and sin √-z/√-z for z < 0; both times exp(-decay)."""
    if type(z) is float:
        r, fade = max(abs(z), 1e-16) ** 0.5, math.exp(-decay)
        return (fade * math.cosh(r), fade * math.sinh(r) / r) if z > 0 else (fade * math.cos(r), fade * math.sin(r) / r)
    r, fade, grows = np.sqrt(np.maximum(np.abs(z), 1e-16)), np.exp(-decay), z > 0
    return fade * choose(grows, np.cosh(r), np.cos(r)), fade * choose(grows, np.sinh(r), np.sin(r)) / r
