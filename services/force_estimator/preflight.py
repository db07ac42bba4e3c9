"""What the last zeroing says against the next one. Pure.

On the ground the observer cannot be zeroed: it is weighed in hover. But a bias comes from the mass, the thrust and the handle's
weight that are believed. As long as they are what they were, the next zeroing will find what the last one found: a vehicle
that would be lifted only to be set down again is told before.
"""

from typing import NamedTuple

from services.force_estimator.bias import Bias
from services.physics import Array, norm

SHARE = 0.5
"""Of what zeroing takes (tare_bias_max_N): with more, a warm motor or another battery may be enough to fail it."""
_CURE = "weigh vehicle and handle, clew calibrate thrust; if something on it was mended, fly a zeroing without a person"


class Zeroing(NamedTuple):
    """What the last one found: in which recording, and the bias, (3,) N, whether it was accepted or not."""

    session: str
    bias_N: Array


def reasons(last: Zeroing | None, p: Bias) -> list[tuple[str, str]]:
    """What stands against a flight, and the cure; without a zeroing nothing is known."""
    if last is None:
        return []
    bias_N, limit_N = float(norm(last.bias_N)), SHARE * p.tare_bias_max_N
    if bias_N <= limit_N:
        return []
    told = f"the last zeroing ({last.session}) found {bias_N:.2f} N of bias: at most {limit_N:g} N to begin"
    return [(f"{told}, half of what zeroing takes", _CURE)]
