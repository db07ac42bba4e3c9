"""What must hold whatever breaks, and what was promised of a fault: which of it was not kept."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from schemas.safety import Action, Level, Permit, Phase
from schemas.topics import ENERGY, REQUEST
from schemas.vehicle import SetpointKind
from services.faults.fault import Fault, Reaction
from services.faults.record import NEVER, Record
from services.physics import Array
from services.px4_bridge.energy import ROUNDING_J

FORCE_N = 2.5
CALM_N, CALM_S = 0.3, 0.5
TIP_M = 0.5
IMPACT_MPS = 1.2
GROUND_M = 0.15
HEARD_S = 0.03
LEFT_S = 6.0


def broken(fault: Fault, r: Record, n: dict[str, Any], reached: Level) -> Iterator[tuple[str, str]]:
    """Each promise that was not kept, by its key, with the number."""
    if n["reaction_s"] > fault.within_s:
        yield "reaction", f"{fault.reaction.value} after {n['reaction_s']:.2f} s, promised {fault.within_s:g} s"
    if fault.reaction is Reaction.NOTHING and reached > Level.WARN:
        yield "alarm", f"level {reached.name.lower()} for nothing"
    if fault.reaction is Reaction.STAYS_DOWN and any(armed for t, _, armed in r.modes if t > 0.0):
        yield "reaction", "armed"
    allowed = max(n["commanded_before_N"], FORCE_N)
    if n["commanded_N"] > allowed + 1e-3:
        yield "commanded", f"commanded {n['commanded_N']:.2f} N, allowed {allowed:.2f} N"
    if n["pull_N"] > fault.pull_max_N:
        yield "pull", f"{n['pull_N']:.2f} N on the hand, promised {fault.pull_max_N:g} N"
    if n["pull_after_ease_N"] > CALM_N:
        yield "calm", f"{n['pull_after_ease_N']:.2f} N on the hand later than {CALM_S:g} s after backing off"
    for part in ("hand", "head"):
        if n[f"tip_{part}_m"] < TIP_M:
            yield f"tip_{part}", f"rotor tip {n[f'tip_{part}_m']:.2f} m from the {part}"
    if n["late_setpoints"]:
        yield "late", f"{n['late_setpoints']} set-points after the death of their loop"
    if n["impact_mps"] > IMPACT_MPS:
        yield "impact", f"met the ground at {n['impact_mps']:.1f} m/s"
    if text := _landed_in_flight(r):
        yield "landed", text
    if _left_armed(r):
        yield "armed", "left armed on the ground"
    if text := _resumed(r):
        yield "resumed", text
    if (made_J := max((m.created_J for m in r.flight.said[ENERGY.key]), default=0.0)) > ROUNDING_J:
        yield "energy", f"the filter made {made_J:.1e} J at its ports"


def _landed_in_flight(r: Record) -> str:
    """Whoever is told that it has landed goes near it."""
    landed_s = next((t for t, m in zip(r.state_s, r.states, strict=True) if m.phase is Phase.LANDED), NEVER)
    heights_m = [m.robot_position_m.z for t, m in zip(r.truth_s, r.truth, strict=True) if t >= landed_s]
    in_flight = heights_m and heights_m[0] > GROUND_M
    return f"said to have landed at {landed_s:.2f} s, {heights_m[0]:.2f} m up" if in_flight else ""


def _left_armed(r: Record) -> bool:
    """Armed, and on the ground for as long as it takes twice to notice."""
    late = [m for t, m in zip(r.truth_s, r.truth, strict=True) if t > r.truth_s[-1] - LEFT_S]
    return r.modes[-1][2] and all(m.robot_position_m.z < GROUND_M for m in late) and r.truth_s[-1] > LEFT_S


def _resumed(r: Record) -> str:
    """Guided without a fresh permit, or again after hold without a person."""
    permits: tuple[Array, list[Permit]] = r.state_s, [m.permit for m in r.states]
    sent_s: list[float] = r.sent_s.tolist()
    for t, m in zip(sent_s, r.sent, strict=True):
        if t <= 0.25 or m.kind is not SetpointKind.ADMITTANCE:
            continue
        last, now = (int(np.searchsorted(permits[0], at, side="right")) for at in (t - HEARD_S, t))
        if not {Permit.WAIT, Permit.GUIDE} & set(permits[1][max(last - 1, 0) : now]):  # what it can have heard
            return f"guided at {t:.2f} s without a permit"
    held = False
    confirmed = [m.stamp_ns * 1e-9 - r.begin_s for m in r.flight.said[REQUEST.key] if m.action is Action.RESUME]
    for t, m in zip(r.state_s, r.states, strict=True):
        held = held or (t > 0.0 and m.phase is Phase.HOLD)
        if held and m.permit is Permit.GUIDE and not any(0.0 < c < t for c in confirmed):
            return "guided after hold without a person's word"
    return ""
