"""What limited the system in a recorded session, from when to when, in the words that the operator was told."""

from collections.abc import Iterator
from typing import NamedTuple

from schemas.safety import Level, Phase
from services.recorder.table import Table


class Alarm(NamedTuple):
    """A stay in one level with the same reasons, s in the table's time."""

    begin_s: float
    end_s: float
    level: Level
    phase: Phase
    text: str


def alarms(states: Table) -> Iterator[Alarm]:
    """Each stay above OK, in order; `states` is the table of safety/state."""
    t_s, levels, reasons = states["t_s"], states["level"], states["reasons"]
    begin = 0
    for i in range(1, len(t_s) + 1):
        if i < len(t_s) and levels[i] == levels[begin] and reasons[i] == reasons[begin]:
            continue
        if levels[begin] > Level.OK:
            end_s = t_s[i] if i < len(t_s) else t_s[-1]
            text = "; ".join(reasons[begin]) or "asked for by the operator"
            yield Alarm(float(t_s[begin]), float(end_s), Level(int(levels[begin])), Phase(states["phase"][begin]), text)
        begin = i
