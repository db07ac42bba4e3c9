"""When faults begin, and what their rows share."""

import asyncio
from collections.abc import Callable

from schemas.safety import Phase
from services.faults.fault import GUIDING, Moment
from services.rehearsal.chain import Stage

Act = Callable[[Stage], None]
MOMENTS = (
    Moment(Phase.TAKEOFF, 2.0),
    Moment(Phase.ZEROING, 0.5),
    Moment(Phase.READY, 1.0),
    GUIDING,
    Moment(Phase.ARRIVED, 0.5),
    Moment(Phase.CLEARING, 2.0),
    Moment(Phase.LANDING, 0.6),
)
OVERHEAD = "the autopilot comes straight down, and the person stands under it until told to step back"
DRAGGED = "the autopilot sinks with the cable in the person's hand"
SINKS = {"tip_hand": OVERHEAD, "tip_head": OVERHEAD, "calm": DRAGGED, "armed": DRAGGED, "impact": DRAGGED}
"""What no software can keep once the autopilot lands by itself with a person under it."""
FALLS: dict[str, str] = dict.fromkeys(("impact", "tip_hand", "tip_head", "calm"), "it falls")
"""Nor once the motors are stopped in the air."""


def later(seconds: float, act: Callable[[], object]) -> None:
    """Do it `seconds` after the fault began."""
    asyncio.get_running_loop().call_later(seconds, act)
