"""The same faults on real PX4 in software: a flight for each, one after the other, because PX4 cannot be copied."""

import shutil
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from services.config import Config
from services.faults import measure
from services.faults.campaign import Look, alone, unremarked
from services.faults.catalogue import every
from services.faults.fault import GUIDING, Fault
from services.faults.measure import Result
from services.rehearsal import px4_flight
from services.rehearsal.quick import quicker

UNNOTICED = ("in disorder", "stands still", "restarted")
NOTICED = ("px4_bridge stands still", "px4_bridge restarted")
"""Where nothing follows, or a service comes back: the autopilot sees nothing, or what it sees where the service died."""


def one_of_each() -> tuple[Fault, ...]:
    """Of each family that the autopilot can notice the first that breaks in the guided walk, or else the first."""
    families: dict[str, list[Fault]] = {}
    for fault in every():
        families.setdefault(fault.family, []).append(fault)
    noticed = (alike for family, alike in families.items() if not family.endswith(UNNOTICED) or family in NOTICED)
    return tuple(min(alike, key=lambda fault: fault.moment is not GUIDING) for alike in noticed)


def campaign(faults: Sequence[Fault], config: Config, folder: Path, look: Look | None = None) -> Iterator[Result]:
    """The results as they come; the session of each flight goes into a folder of its name."""
    with unremarked():
        for fault in faults:
            here = quicker(config).model_copy(update={"session_dir": str(folder / fault.name)})
            why_not = fault.on_px4.not_flown
            yield measure.not_flown(fault, why_not) if why_not else _flown(fault, here, look)


def _flown(fault: Fault, config: Config, look: Look | None) -> Result:
    shutil.rmtree(Path(config.session_dir) / "px4", ignore_errors=True)  # where parameters stay, a fault's too
    try:
        flight, begin_s = alone(fault, config, px4_flight.fly)
    except Exception:
        return measure.unmeasured(fault, traceback.format_exc())
    if look:
        look(fault, flight, begin_s)
    known = fault.on_px4
    lenient = replace(fault, within_s=fault.within_s + known.late_s, exempt=fault.exempt | known.exempt)
    return excused(fault, measure.measure(lenient, flight, begin_s))


def excused(fault: Fault, result: Result) -> Result:
    """Of a fault that may lead to its reaction later: the promise as it is for all, and why it was not kept."""
    result = replace(result, within_s=fault.within_s)
    if result.reaction_s <= fault.within_s or not fault.on_px4.late_s or not result.ok:
        return result
    text = f"{result.reaction} after {result.reaction_s:.2f} s, promised {fault.within_s:g} s ({fault.on_px4.late})"
    return replace(result, exempt=(*result.exempt, text))
