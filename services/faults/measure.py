"""What a fault did: times, forces and distances of one flight, by the simulator's truth, and which promises it broke."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from schemas.safety import Level, Phase
from schemas.topics import ENERGY, REQUEST, SAFETY_STATE, SETPOINT, TRUTH
from schemas.vehicle import FlightMode, SetpointKind
from services.faults.fault import Fault, Reaction
from services.faults.promises import CALM_S, GROUND_M, broken
from services.faults.record import NEVER, Record
from services.physics import Array, norm
from services.rehearsal.chain import Flight

TOPICS = tuple(topic.key for topic in (ENERGY, REQUEST, SAFETY_STATE, SETPOINT, TRUTH))
"""What is measured by."""
SLACK = (SetpointKind.EASE, SetpointKind.HOLD)
SILENCE_S = 0.1
_NUMBERS = (
    "reaction_s",
    "commanded_before_N",
    "commanded_N",
    "pull_before_N",
    "pull_N",
    "pull_after_ease_N",
    "tip_hand_m",
    "tip_head_m",
    "impact_mps",
)


@dataclass(frozen=True)
class Result:
    """Of one fault; times in s since it began, inf for never. `broken` names the promises that were not kept."""

    name: str
    group: str
    reaction: str
    within_s: float
    reaction_s: float
    commanded_before_N: float
    commanded_N: float
    pull_before_N: float
    pull_N: float
    pull_after_ease_N: float
    tip_hand_m: float
    tip_head_m: float
    late_setpoints: int
    level: str
    phase: str
    impact_mps: float
    broken: tuple[str, ...]
    exempt: tuple[str, ...]
    reasons: tuple[str, ...]
    not_flown: str = ""
    """Why not, where it was not."""

    @property
    def ok(self) -> bool:
        """Whether every promise was kept."""
        return not self.broken

    @property
    def verdict(self) -> str:
        """In a word, or in those that say why."""
        if self.not_flown:
            return f"not flown: {self.not_flown}"
        return "kept" if self.ok else "; ".join(self.broken)


def measure(fault: Fault, flight: Flight, begin_s: float) -> Result:
    """Everything about one flight that the fault began at `begin_s` of."""
    r = Record(flight, begin_s)
    eased_s = r.first(r.sent_s, r.sent, lambda m: m.kind in SLACK)
    if fault.reaction is Reaction.HANDS_OFF:
        eased_s = min(eased_s, reaction_s(fault, r))
    before_s, after = (r.sent_s <= 0.0) & (r.sent_s > -0.5), r.sent_s > 0.0
    held_before = (r.truth_s <= 0.0) & (r.truth_s > -0.5)
    reached = max((m.level for t, m in zip(r.state_s, r.states, strict=True) if t > 0.0), default=Level.OK)
    last = r.states[-1] if r.states else None
    numbers: dict[str, Any] = {
        "reaction_s": reaction_s(fault, r),
        "commanded_before_N": _most(r.u_A_N[before_s]),
        "commanded_N": _most(r.u_A_N[after]),
        "pull_before_N": _most(r.pull_N[held_before]),
        "pull_N": _most(r.pull_N[r.truth_s > 0.0]),
        "pull_after_ease_N": _after_ease_N(r, eased_s),
        "tip_hand_m": float(np.min(r.tips_m("hand"))),
        "tip_head_m": float(np.min(r.tips_m("head"))),
        "late_setpoints": _late_setpoints(r) if fault.reaction is Reaction.AUTOPILOT_LANDS else 0,
        "impact_mps": _impact_mps(r),
    }
    found = dict(broken(fault, r, numbers, reached))
    return Result(
        name=fault.name,
        group=fault.group.value,
        reaction=fault.reaction.value,
        within_s=fault.within_s,
        level=reached.name.lower(),
        phase=last.phase.value if last else "",
        broken=tuple(text for key, text in found.items() if key not in fault.exempt),
        exempt=tuple(f"{text} ({fault.exempt[key]})" for key, text in found.items() if key in fault.exempt),
        reasons=_reasons(r),
        **numbers,
    )


def unmeasured(fault: Fault, error: str) -> Result:
    """Of a fault whose flight failed, with the reason: a broken promise."""
    return replace(not_flown(fault, ""), broken=(error.strip().splitlines()[-1],), reasons=(error,))


def not_flown(fault: Fault, why: str) -> Result:
    """Of a fault that this vehicle cannot be made to have."""
    nothing: dict[str, Any] = dict.fromkeys(_NUMBERS, 0.0)
    return Result(
        name=fault.name,
        group=fault.group.value,
        reaction=fault.reaction.value,
        within_s=fault.within_s,
        late_setpoints=0,
        level="",
        phase="",
        broken=(),
        exempt=(),
        reasons=(),
        not_flown=why,
        **nothing,
    )


def _most(values: Array) -> float:
    return float(np.max(values)) if len(values) else 0.0


def reaction_s(fault: Fault, r: Record) -> float:
    """When what the fault must lead to was there, in what leaves for the vehicle or in the vehicle itself."""
    eased = r.first(r.sent_s, r.sent, lambda m: m.kind in SLACK)
    held = r.first(r.sent_s, r.sent, lambda m: m.kind is SetpointKind.HOLD)
    lands = next((max(t, 0.0) for t, mode, _ in r.now() if mode in (FlightMode.LAND, FlightMode.DESCEND)), NEVER)
    off = next((t for t, _, armed in r.modes if t > 0.0 and not armed), NEVER)
    match fault.reaction:
        case Reaction.LET_GO:
            return min(r.first(r.sent_s, r.sent, lambda m: bool(norm(m.u_A_N.array()[:2]) < 0.25)), eased)
        case Reaction.EASE:
            return min(eased, lands)
        case Reaction.HOLD:
            return min(held, lands)
        case Reaction.HANDS_OFF:
            last_s = r.sent_s[-1] if len(r.sent_s) else 0.0
            return max(float(last_s), 0.0) if r.truth_s[-1] - last_s > CALM_S else NEVER
        case Reaction.LAND:
            clears = r.first(r.state_s, r.states, lambda m: m.phase in (Phase.CLEARING, Phase.LANDING))
            return min(lands, clears)
        case Reaction.AUTOPILOT_LANDS:
            return lands
        case Reaction.DISARMED:
            return off
        case _:
            return 0.0


def _after_ease_N(r: Record, eased_s: float) -> float:
    """The strongest pull from half a second after the system backed off, for as long as it stays backed off."""
    again = [t for t, m in zip(r.sent_s, r.sent, strict=True) if t > eased_s and m.kind not in SLACK]
    until = min(again, default=NEVER)
    return _most(r.pull_N[(r.truth_s > eased_s + CALM_S) & (r.truth_s < until)])


def _late_setpoints(r: Record) -> int:
    """Sent more than 0.1 s after the loop that makes them stood still; only counted where it did for good."""
    return sum(ns * 1e-9 - r.begin_s > SILENCE_S for ns in r.flight.vehicle.sent_ns)


def _impact_mps(r: Record) -> float:
    """How fast the vehicle met the ground, 0 where it did not."""
    hit = [
        -m.robot_velocity_mps.z
        for t, m in zip(r.truth_s, r.truth, strict=True)
        if t > 0.0 and m.robot_position_m.z < GROUND_M
    ]
    return max([0.0, *hit])


def _reasons(r: Record) -> tuple[str, ...]:
    """What the operator was told, each once, in the order of its first appearance."""
    said = [m.reasons[0] for t, m in zip(r.state_s, r.states, strict=True) if t > 0.0 and m.reasons]
    return tuple(dict.fromkeys(said))[:4]
