"""How late the cable's force is when it is flown: the delay in the loop that holds the hand.

A host that is shared makes every loop a little late, and none so late that it counts as a stall. Fed forward late, the force
pushes where it should give way (G2, G5): the cable then bounces. The bridge says with each set-point how old the force is.
"""

import math

LATE_S = 0.04
"""3 to 8 ms where the host has time, 120 to 160 ms with ten times too much to do; 50 ms late it is felt (G2)."""
TAU_S = 0.5
MOST_S = 0.2
"""What is older counts as silent elsewhere, and not for longer here."""


def step(lag_s: float, age_s: float, dt: float) -> float:
    """The mean age in s, `dt` s later; `age_s` is that of the newest set-point's force."""
    return lag_s - math.expm1(-dt / TAU_S) * (min(age_s, MOST_S) - lag_s)
