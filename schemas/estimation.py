"""The cable force, as the wrench observer sees it."""

from enum import StrEnum

from schemas.message import Message, Vec3


class Tare(StrEnum):
    """Zeroing of the observer in hover."""

    NONE = "none"
    RUNNING = "running"
    PASSED = "passed"
    FAILED = "failed"


class CableForce(Message):
    """f̂_c: the force on the handle, towards the robot; the robot feels -f̂_c.

    `force_N` is free of the estimated bias and contains the handle's weight while the handle hangs; `observed_N` is the
    observer's output before that. `bias_change_N` is how far the bias has moved since zeroing.
    """

    force_N: Vec3
    observed_N: Vec3
    bias_N: Vec3
    bias_change_N: float
    taut: bool
    slack_m: float
    """How far the cable's ends are inside its rest length by motion capture; negative when stretched or unknown."""
    tare: Tare
    tare_report: str
