"""The stand-in's half of MAVLink's TIMESYNC, as PX4 has it: what a companion's stamp is on the vehicle's own clock. Pure.

The vehicle asks for the companion's time and takes the middle of its round trips. Before enough of them a stamp is not
believed, and what it dates counts as taken when it arrives.
"""

from dataclasses import dataclass

WINDOW = 500
"""Answers before it is believed: PX4's CONVERGENCE_WINDOW."""
ROUND_TRIP_MAX_us = 10_000
DEVIATION_MAX_us = 100_000
_JUMPS_MAX = 10
_GAIN_MIN = 0.003


@dataclass
class Timesync:
    """What is known of the companion's clock. Raises nothing; a clock that jumps is begun anew."""

    answers: int = 0
    _offset_us: float = 0.0
    _jumps: int = 0

    @property
    def converged(self) -> bool:
        """Whether stamps are believed."""
        return self.answers >= WINDOW

    def take(self, now_us: float, theirs_us: float, asked_us: float) -> None:
        """An answer that has just arrived to what was asked at `asked_us`."""
        offset_us = (asked_us + now_us) / 2.0 - theirs_us
        if now_us - asked_us > ROUND_TRIP_MAX_us:
            return
        if self.converged and abs(offset_us - self._offset_us) > DEVIATION_MAX_us:
            self._jumps += 1
            if self._jumps > _JUMPS_MAX:
                self.answers = self._jumps = 0
            return
        self.answers, self._jumps = self.answers + 1, 0
        self._offset_us += max(1.0 / self.answers, _GAIN_MIN) * (offset_us - self._offset_us)

    def age_s(self, stamp_us: float, now_us: float) -> float:
        """Of what the companion stamped; 0 while that is not known, and never below."""
        return max(now_us - stamp_us - self._offset_us, 0.0) * 1e-6 if self.converged else 0.0
