"""What the set-point loop hears, and what it is worth: the supervisor's word, forces, guidance, the hand, a person's kill.

All that is remembered from one turn to the next is forgotten while no set-points leave (`forget`), or named among the
`inputs`: so a recorded flight can be run again exactly.
"""

from dataclasses import dataclass

import numpy as np

from schemas.safety import Action, Permit, Phase
from schemas.topics import CABLE_FORCE, GUIDANCE, HANDLE_STATE, REQUEST, SAFETY_STATE
from schemas.tracking import HIDDEN, HandleSource
from schemas.vehicle import VehicleState
from services.config import Config
from services.physics import norm
from services.px4_bridge import flight, permits
from services.px4_bridge.flight import Force, Guidance
from services.px4_bridge.leash import Hand
from services.px4_bridge.trust import credible_force, credible_guidance
from services.runtime.node import Node, Tick, used

HAND_MEMORY_S = 1.0  # long enough to back off by
SHORT_M = 0.05  # what motion capture and the autopilot differ by about it is less


@dataclass
class Word:
    """The supervisor's word as it counts now, shared by the set-point loop and the orders."""

    permit: Permit = Permit.NONE
    said: Permit | None = None
    phase: Phase = Phase.IDLE
    fresh_ns: int = 0
    """When a word was last true and new."""
    killed: bool = False
    """By a person, and for good: flying again needs a new start of this service."""


class Ears:
    """The readers of the set-point loop."""

    def __init__(self, node: Node, config: Config) -> None:
        self._node, self._config = node, config
        self._safety, self._guidance = node.latest(SAFETY_STATE), node.latest(GUIDANCE)
        self._handle = node.latest(HANDLE_STATE)
        self._forces, self._requests = node.queue(CABLE_FORCE), node.queue(REQUEST)
        self.word = Word()
        self.force_ns = 0
        """Stamp of the last cable force that can be true."""
        self._last_was_good = False
        self._seen: Hand | None = None
        self._seen_ns = 0
        self._doubted = False
        """Whether the tracker contradicts what motion capture shows."""

    def forget(self) -> None:
        """All but the last message of each topic."""
        self._seen = None
        if not self._last_was_good:
            self.force_ns = 0

    def inputs(self, tick: Tick) -> dict[str, int]:
        """What a set-point is made of, beside the vehicle's state."""
        return used(self._forces, self._guidance, self._safety, self._handle, self._requests, tick=tick)

    def listen(self) -> Word:
        """The supervisor's newest valid word, worth what its age allows; a person's kill counts for ever."""
        link, heard, word, now_ns = self._config.px4_bridge.link, self._safety.message, self.word, self._now_ns()
        if heard is not None and heard.valid and self._word_age_s() <= link.permit_silent_s:
            word.said, word.phase, word.fresh_ns = heard.permit, heard.phase, min(heard.stamp_ns, now_ns)
        age_s = (now_ns - word.fresh_ns) * 1e-9
        permit = permits.effective(word.said, age_s, link.permit_silent_s, link.permit_lost_s)
        asked = any(request.action is Action.KILL for request in self._requests.drain())
        word.killed |= asked or permit is Permit.KILL
        word.permit = Permit.KILL if word.killed else permit
        return word

    def _word_age_s(self) -> float:
        """The worst reading of it: a clock may be wrong either way."""
        heard, now_ns = self._safety.message, self._now_ns()
        ahead_s = (heard.stamp_ns - now_ns) * 1e-9 if heard else 0.0
        return max(self._safety.age_s, ahead_s, (now_ns - self._safety.received_ns) * 1e-9)

    def new_forces(self, in_air: bool) -> list[Force]:
        """Force samples that can be true, since the last tick, with the time from one to the next."""
        forces: list[Force] = []
        for sample in self._forces.drain():
            f_c = sample.force_N.array()
            possible = credible_force(f_c, self._config.px4_bridge.trust)
            self._last_was_good = possible and sample.valid
            if not possible and in_air:  # the ground carries what no cable can
                self._node.reject(CABLE_FORCE.key, f"force_N = {f_c}: no cable pulls like that")
            if self._last_was_good:
                dt_s = min(max((sample.stamp_ns - self.force_ns) * 1e-9, 1e-4), 0.1)
                self.force_ns = sample.stamp_ns
                slack = sample.slack_m > self._config.force_estimator.bias.slack_margin_m
                forces.append(Force(f_c, slack, dt_s))
        return forces

    def input(self, forces: list[Force], robot: VehicleState, state: flight.State) -> flight.Input:
        """Of one tick of the law."""
        heard = self._safety.message
        return flight.Input(
            permit=self.word.permit,
            goal=heard.goal_m.array() if heard else np.zeros(3),
            speed_mps=heard.speed_mps if heard else 0.0,
            held=heard is not None and heard.held,
            forces=forces,
            force_fresh=self._now_ns() - self.force_ns < 1e9 * self._config.px4_bridge.link.force_silent_s,
            guidance=self._guided(state),
            hand=self._hand(robot),
        )

    def _guided(self, state: flight.State) -> Guidance | None:
        """What the ground asks for, where it is fresh and can be meant."""
        command = self._guidance.value
        if command is None:
            return None
        guidance = Guidance(command.p_R_d_m.array(), command.f_d_N.array(), command.scale)
        if credible_guidance(guidance, state.filter.p, self._config.px4_bridge.trust):
            return guidance
        self._node.reject(GUIDANCE.key, f"p_R_d_m = {guidance.p_R_d}, f_d_N = {guidance.f_d}: cannot be meant")
        return None

    def _hand(self, robot: VehicleState) -> Hand | None:
        """Where motion capture sees the handle, or saw it a moment ago."""
        handle, now_ns = self._handle.value, self._now_ns()
        if handle is not None and handle.source is HandleSource.MOCAP:
            p_H = handle.position_m.array()
            inside = norm(p_H - robot.position_m.array()) < self._config.safety_supervisor.envelope.rotor_tip_m
            out_of_reach = p_H[2] > self._config.px4_bridge.flight.ceiling_m
            if not (
                inside or out_of_reach
            ):  # else it is the vehicle itself, or hangs below it on a cable that is caught
                self._seen, self._seen_ns = Hand(p_H, np.zeros(3)), now_ns
                return Hand(p_H, handle.velocity_mps.array())
        told, before = self._handle.message, self._doubted
        self._doubted = told is not None and not told.valid and not told.invalid_reason.startswith(HIDDEN)
        if self._doubted and not before and self._misled(robot):
            self._seen = None
        return self._seen if now_ns - self._seen_ns < HAND_MEMORY_S * 1e9 else None

    def _misled(self, robot: VehicleState) -> bool:
        """Whether the hand was last seen nearer than a taut cable lets anything be."""
        shortest_m = self._config.cable.rest_length_m - SHORT_M
        return self._seen is not None and bool(norm(self._seen.p - robot.position_m.array()) < shortest_m)

    def _now_ns(self) -> int:
        return self._node.turn.now_ns()
