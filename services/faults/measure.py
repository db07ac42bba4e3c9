"""What a fault did: times, forces and distances of one flight, by the simulator's truth, and which promises it broke."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.safety import Action, Level, Permit, Phase
from schemas.simulation import Truth
from schemas.topics import ENERGY, REQUEST, SAFETY_STATE, SETPOINT, TRUTH
from schemas.vehicle import SetpointKind
from services.faults.fault import Fault, Reaction
from services.physics import norm
from services.px4_bridge.energy import ROUNDING_J
from services.rehearsal.chain import Flight
from services.simulator.commander import Mode

Array = NDArray[np.float64]

TOPICS = tuple(topic.key for topic in (ENERGY, REQUEST, SAFETY_STATE, SETPOINT, TRUTH))
"""What is measured by."""
SLACK = (SetpointKind.EASE, SetpointKind.HOLD)
FORCE_N = 2.5
CALM_N, CALM_S = 0.3, 0.5
TIP_M = 0.5
SILENCE_S = 0.1
IMPACT_MPS = 1.2
GROUND_M = 0.15
HEARD_S = 0.03
LEFT_S = 6.0
NEVER = float("inf")
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

    @property
    def ok(self) -> bool:
        """Whether every promise was kept."""
        return not self.broken


def _pull_N(truth: Truth) -> float:
    """Of the cable on the hand that holds: what is more than the carrying of the handle, which a slack cable leaves to it."""
    if not truth.holding:
        return 0.0
    return float(min(norm(truth.cable_force_N.array()), norm(truth.hand_force_N.array())))


class Record:
    """One flight as arrays, from the fault on, times counted from it."""

    def __init__(self, flight: Flight, begin_s: float) -> None:
        self.flight, self.begin_s = flight, begin_s
        self.sent = flight.said[SETPOINT.key]
        self.states = flight.said[SAFETY_STATE.key]
        self.truth = flight.said[TRUTH.key]
        self.sent_s, self.state_s, self.truth_s = (self._times(m) for m in (self.sent, self.states, self.truth))
        self.pull_N = np.array([_pull_N(m) for m in self.truth])
        self.u_A_N = np.array(
            [norm(m.u_A_N.array()) if m.kind is not SetpointKind.POSITION else 0.0 for m in self.sent]
        )
        self.modes = [(ns * 1e-9 - begin_s, mode, armed) for ns, mode, armed in flight.vehicle.modes]

    def _times(self, messages: Sequence[Any]) -> Array:
        return np.array([m.stamp_ns for m in messages]) * 1e-9 - self.begin_s

    def first(self, times: Array, messages: Sequence[Any], shows: Callable[[Any], bool]) -> float:
        """When a message after the fault first shows it."""
        return next((float(t) for t, m in zip(times, messages, strict=True) if t > 0.0 and shows(m)), NEVER)

    def now(self) -> list[tuple[float, Mode, bool]]:
        """The autopilot's modes from the one that the fault found on."""
        found = max((n for n, (t, _, _) in enumerate(self.modes) if t <= 0.0), default=0)
        return self.modes[found:]

    def tips_m(self, of: str) -> Array:
        """Nearest rotor tip to the person's hand or head, while the motors run and since the fault."""
        tip_m = self.flight.config.safety_supervisor.envelope.rotor_tip_m
        off_s = next((t for t, _, armed in self.modes if t > 0.0 and not armed), NEVER)
        return np.array(
            [
                norm(m.robot_position_m.array() - getattr(m, f"{of}_position_m").array()) - tip_m
                for t, m in zip(self.truth_s, self.truth, strict=True)
                if 0.0 < t < off_s
            ]
            or [NEVER]
        )


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
    found = dict(_broken(fault, r, numbers, reached))
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
    """Of a fault that could not be flown, with the reason."""
    nothing: dict[str, Any] = dict.fromkeys(_NUMBERS, 0.0)
    return Result(
        name=fault.name,
        group=fault.group.value,
        reaction=fault.reaction.value,
        within_s=fault.within_s,
        late_setpoints=0,
        level="",
        phase="",
        broken=(error.strip().splitlines()[-1],),
        exempt=(),
        reasons=(error,),
        **nothing,
    )


def _most(values: Array) -> float:
    return float(np.max(values)) if len(values) else 0.0


def reaction_s(fault: Fault, r: Record) -> float:
    """When what the fault must lead to was there, in what leaves for the vehicle or in the vehicle itself."""
    eased = r.first(r.sent_s, r.sent, lambda m: m.kind in SLACK)
    held = r.first(r.sent_s, r.sent, lambda m: m.kind is SetpointKind.HOLD)
    lands = next((max(t, 0.0) for t, mode, _ in r.now() if mode in (Mode.LAND, Mode.DESCEND)), NEVER)
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


def _broken(fault: Fault, r: Record, n: dict[str, Any], reached: Level) -> Iterator[tuple[str, str]]:
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
    if _left_armed(r):
        yield "armed", "left armed on the ground"
    if text := _resumed(r):
        yield "resumed", text
    if (made_J := max((m.created_J for m in r.flight.said[ENERGY.key]), default=0.0)) > ROUNDING_J:
        yield "energy", f"the filter made {made_J:.1e} J at its ports"


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
