"""A slower rate inside a faster loop."""


class Pace:
    """`due` says yes as often as `rate_Hz` asks: exactly on average, to the loop's own period each time.

    After a gap it says yes once, not once for each period that was missed.
    """

    def __init__(self, rate_Hz: float) -> None:
        self._period_ns = round(1e9 / rate_Hz)
        self._next_ns = 0

    def due(self, now_ns: int) -> bool:
        """Whether this turn of the loop is one of them."""
        if now_ns < self._next_ns:
            return False
        self._next_ns = max(self._next_ns + self._period_ns, now_ns)
        return True
