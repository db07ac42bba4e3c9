"""Stamps across two hosts: each is on the clock of its publisher's host, readers want it on their own.

How far the clocks are apart is measured by the drone's gateway and published (schemas/radio.py); every node of a system
of two hosts listens to it. Until it is known, what comes from the other host has no age and is not fresh.
"""

from collections.abc import Callable
from typing import TypeVar

from schemas.message import Message
from schemas.radio import RadioClock
from schemas.topics import RADIO_CLOCK
from services.parameters import NonNegative, parameters

M = TypeVar("M", bound=Message)

AHEAD_ns = 20_000_000
"""How far a stamp may lie in the future, beyond what is not known of the clocks."""


@parameters
class Placement:
    """Where this process runs, and who runs elsewhere. `here` is empty in a system on one host."""

    here: str = ""
    elsewhere: tuple[str, ...] = ()
    delay_allowed_s: NonNegative = 0.0
    """By how much what crosses the radio may be older than what does not."""


class Hosts:
    """The clock of the other host, as this process knows it."""

    def __init__(self, placement: Placement | None = None) -> None:
        self._placement = placement or Placement()
        self._elsewhere = frozenset(self._placement.elsewhere)
        self._clock: RadioClock | None = None
        self.look: Callable[[], None] = lambda: None
        """Takes what has arrived of the comparisons."""

    @property
    def two(self) -> bool:
        """Whether there is another host at all."""
        return bool(self._elsewhere)

    def note(self, clock: RadioClock) -> None:
        """Take the newest comparison; one without a result changes nothing."""
        if clock.valid:
            self._clock = clock

    def crosses(self, publisher: str) -> bool:
        """Whether what `publisher` says comes over the radio."""
        return publisher in self._elsewhere

    def allowance_ns(self, publisher: str) -> int:
        """What the radio may add to the age of its messages."""
        return round(self._placement.delay_allowed_s * 1e9) if self.crosses(publisher) else 0

    def here_ns(self, publisher: str, stamp_ns: int) -> int | None:
        """A stamp of `publisher` on this host's clock; None while the clocks have not been compared."""
        if not self.crosses(publisher):
            return stamp_ns
        self.look()
        if self._clock is None:
            return None
        lead = self._clock.ground_minus_drone_ns
        return stamp_ns + (lead if self._placement.here == "ground" else -lead)

    def here(self, publisher: str, message: M) -> M:
        """A message of `publisher` with its stamp on this host's clock; as it was said while that is not known."""
        here_ns = self.here_ns(publisher, message.stamp_ns)
        return message if here_ns in (None, message.stamp_ns) else message.model_copy(update={"stamp_ns": here_ns})

    def inputs(self, publisher: str) -> dict[str, int]:
        """The seq of the comparison by which stamps of `publisher` are judged now, by its topic; empty for none."""
        return {RADIO_CLOCK.key: self._clock.seq} if self._clock and self.crosses(publisher) else {}

    def ahead_ns(self, publisher: str) -> int:
        """How far a stamp of `publisher` may lie in the future."""
        known = self._clock is not None and self.crosses(publisher)
        return AHEAD_ns + (round(self._clock.uncertainty_s * 1e9) if known and self._clock else 0)
