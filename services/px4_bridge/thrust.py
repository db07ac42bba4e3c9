"""From what the motors are told, or from how fast they turn, to newtons.

| symbol | here | unit |
|---|---|---|
| u_i, share of its range that motor i uses | | |
| mean of u_i, mean of u_i² | Throttle.mean, square | |
| T, along +z of the body | newtons | N |

T = T_max ((1 - c) mean(u) + c mean(u²)) (V/V_0)^k. c is PX4's THR_MDL_FAC: 0 where thrust is proportional to the output, 1
where it goes with its square, as it does with the speed of a propeller. k is 0 where the voltage makes no difference or is not
known. All of it is linear in T_max (1 - c) and T_max c, which is how `clew calibrate thrust` finds them.
"""

from typing import NamedTuple

from schemas.vehicle import ThrustSource
from services.parameters import NonNegative, Positive, parameters
from services.physics import Scalar


@parameters
class Thrust:
    """Where thrust comes from, the model, and how wrong it may be. A real vehicle's is calibrated."""

    thrust_source: ThrustSource
    max_thrust_N: Positive
    """All motors together at full range."""
    thrust_curve: float = 0.0
    thrust_error: NonNegative = 0.0
    """Relative, as stated by whoever found the model; 5 % of it is 0.4 N of bias on 0.8 kg (G8)."""
    voltage_exponent: NonNegative = 0.0
    reference_V: Positive = 1.0
    """The battery's voltage at which `max_thrust_N` holds."""
    rpm_max: Positive = 1.0
    """With esc_rpm: the speed that counts as full range."""


class Throttle(NamedTuple):
    """Means over the motors of the share of the range and of its square."""

    mean: Scalar
    square: Scalar


def throttle(shares: list[float]) -> Throttle:
    """Of one vehicle's motors, each kept between 0 and 1."""
    kept = [min(max(u, 0.0), 1.0) for u in shares]
    return Throttle(sum(kept) / len(kept), sum(u * u for u in kept) / len(kept))


def newtons(u: Throttle, battery_V: Scalar, p: Thrust) -> Scalar:
    """T in N, (...); a voltage of 0 is not known and counts as the reference."""
    share = (1.0 - p.thrust_curve) * u.mean + p.thrust_curve * u.square
    if p.voltage_exponent == 0.0 or battery_V <= 0.0:
        return p.max_thrust_N * share
    return p.max_thrust_N * share * (battery_V / p.reference_V) ** p.voltage_exponent
