"""The numbers of a session with their names, units and definitions: one table for the terminal and the page."""

from typing import Any, NamedTuple

from services.recorder.summary import Summary


class Number(NamedTuple):
    """One row. `key` is its place in summary.json, `factor` brings it into `unit`."""

    key: str
    name: str
    factor: float
    unit: str
    definition: str


# fmt: off
NUMBERS = (
    Number("path_error.mean_m", "path error, mean", 100.0, "cm", "mean over s of |e_H(s)|, the distance from the path at which the hand crosses its normal at s (E7); phase 2"),
    Number("path_error.max_m", "path error, largest", 100.0, "cm", "largest |e_H(s)| over s; phase 2"),
    Number("end_error_m", "from the end of the path", 100.0, "cm", "horizontal distance of the hand from the end when phase 2 ends"),
    Number("slack_fraction", "cable slack", 100.0, "%", "share of phase 2 in which the cable carries less than 0.01 N"),
    Number("hand_force.max_n", "force on the hand, largest", 1.0, "N", "largest pull less the handle's weight, while the handle is held"),
    Number("force_error.rms_n", "force error", 1.0, "N", "RMS over phase 2 of the estimated cable force less the simulator's true one"),
    Number("tracking_error.rms_m", "tracking error", 100.0, "cm", "RMS over phase 2 of the robot's position less the admittance filter's reference"),
    Number("head_clearance_m", "rotor to head, nearest", 1.0, "m", "from the nearest rotor tip to the head, while the handle is held (G10)"),
    Number("durations_s.guiding", "phase 2", 1.0, "s", "time in the phase guiding"),
    Number("latency.total.p50_ms", "hand to set-point, median", 1.0, "ms", "from the capture of the hand to the first set-point that it reached"),
    Number("latency.total.p99_ms", "hand to set-point, 99 %", 1.0, "ms", "99 % of hand samples reached a set-point within this"),
    Number("messages", "messages", 1.0, "", "in the recording"),
    Number("messages_lost", "messages lost", 1.0, "", "gaps in seq, and messages that were malformed"),
    Number("messages_lost_on_radio", "lost on the radio", 1.0, "", "gaps in seq of what the other host said"),
    Number("host_stalls", "host stalls", 1.0, "", "how often the host took the processor away for longer than the supervisor tolerates"),
)
# fmt: on


BY_KEY = {number.key: number for number in NUMBERS}


def value(summary: Summary, number: Number) -> float | None:
    """In the number's unit; None where the recording cannot tell."""
    found: Any = summary.model_dump()
    for name in number.key.split("."):
        found = found.get(name) if found is not None else None
    return None if found is None else float(found) * number.factor
