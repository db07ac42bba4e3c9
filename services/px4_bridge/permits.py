"""What the supervisor's word is worth when it grows old: the bridge's own last line.

Silent for a moment: give way, no pull. Silent for long: land by command. Never older than that, never more than was allowed.
A word to land or to stop the motors does not grow old.
"""

from schemas.safety import Permit


def effective(permit: Permit | None, age_s: float, silent_s: float, lost_s: float) -> Permit:
    """The permit to obey now; `permit` is the last valid one (None: never any), `age_s` the age of its content."""
    if permit is None or permit is Permit.NONE:
        return Permit.NONE
    if age_s <= silent_s or permit in (Permit.LAND, Permit.KILL):
        return permit
    return Permit.EASE if age_s <= lost_s else Permit.LAND
