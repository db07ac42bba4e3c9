"""What the two hosts know of the radio between them."""

from schemas.message import Message


class RadioClock(Message):
    """How far the clocks of the two hosts are apart, measured by queries over the radio.

    A stamp of the ground's clock less `ground_minus_drone_ns` is on the drone's. `valid` is false until both have been
    compared. `uncertainty_s` bounds the error: half the round trip of the best comparison, and what clocks may have
    drifted since.
    """

    ground_minus_drone_ns: int
    uncertainty_s: float
    round_trip_s: float
    """Of the last answer; 0 before the first."""
    time_of_day_apart_s: float
    """Ground less drone: what a common time server would make small."""
    up: bool
    """The other gateway answered within the last second."""
    connects: int
    """How often the radio link has been made."""
    unanswered: int
    """Questions without an answer."""
