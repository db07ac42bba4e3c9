"""Each service's own word about itself; presence is a liveliness token, health is this."""

from schemas.message import Message


class Heartbeat(Message):
    """Written by the service's own loop, so a hung loop is silent."""

    service: str
    pid: int
    loop_rate_Hz: float
    loop_lateness_p99_ms: float
    missed_periods: int
    longest_stall_ms: float
    cpu_fraction: float
    received: dict[str, int]
    rejected: dict[str, int]
    """Per topic: samples refused because they were malformed, non-finite, misaddressed or out of order. Of a gateway also
    what its access rules refused: `put guidance/command by viewer:screen`."""
    status: str
