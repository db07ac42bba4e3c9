"""The operator's side of the bus: a command is repeated until the supervisor has answered it, then seen to be obeyed.

Answered is not obeyed. `stop`, `hold` and `land` count when the bridge's own set-points say so, made of a verdict that came
after the command; `kill` counts when the vehicle says that it is disarmed, whoever answered.
"""

import asyncio
import itertools
import os
import secrets
import socket
import sys
from collections.abc import Callable
from typing import TypeVar

from schemas.safety import RAISES, Action, OperatorReply, OperatorRequest
from schemas.topics import OPERATOR, REPLY, REQUEST, SAFETY_STATE, SETPOINT, VEHICLE_STATE
from schemas.vehicle import FlightMode, SetpointKind
from services.config import ConfigError, load, told_in
from services.console.start import clock_of, observer_bus
from services.runtime.bus import Bus
from services.runtime.clock import Clock
from services.runtime.hosts import Placement
from services.runtime.node import Node
from services.runtime.zenoh_bus import open_bus

T = TypeVar("T")

REPEAT_S, LOOK_S = 0.05, 0.005
ANSWER_S, OBEY_S = 5.0, 2.0
SLACK = (SetpointKind.EASE, SetpointKind.HOLD)
KINDS = {
    Action.EASE: SLACK,  # a graver level is in force where it holds
    Action.HOLD: (SetpointKind.HOLD,),
    Action.LAND: (*SLACK, SetpointKind.POSITION),
}
"""How the bridge flies once it obeys."""
INSTEAD = "Use the radio control's kill switch; a bridge that is dead lets the autopilot land within 1 s."


def operator_node(bus: Bus, clock: Clock, placement: Placement | None = None) -> Node:
    """A node that may read everything and write requests."""
    return Node(OPERATOR, bus, clock, observer=True, placement=placement)


class Operator:
    """One person's commands over one node."""

    def __init__(self, node: Node) -> None:
        self._clock = node.clock
        self._requests, self._replies = node.publisher(REQUEST), node.queue(REPLY)
        self._answers: dict[int, OperatorReply] = {}
        self._safety, self._setpoint = node.latest(SAFETY_STATE), node.latest(SETPOINT)
        self._vehicle = node.latest(VEHICLE_STATE)
        self._ids = itertools.count(secrets.randbits(48))  # no other console's: a known one is answered, not acted upon
        self.name = f"{os.environ.get('USER', 'operator')}@{socket.gethostname()}"

    async def ask(self, action: Action, timeout_s: float = 2.0) -> OperatorReply | None:
        """Send until answered; None where nobody answers within `timeout_s`."""
        request = OperatorRequest(action=action, operator=self.name, request_id=next(self._ids))
        repeats = asyncio.create_task(self._repeat(request))
        try:
            return await self._when(lambda: self._answer(request.request_id), timeout_s)
        finally:
            repeats.cancel()

    async def obeyed(self, action: Action, since_ns: int, timeout_s: float = OBEY_S) -> str:
        """Wait until the vehicle does what `action` asked for at `since_ns`; in words how, empty where it does not."""
        shown = self._motors_off if action is Action.KILL else lambda: self._backed_off(action, since_ns)
        return await self._when(shown, timeout_s) or ""

    async def command(self, action: Action, tell: Callable[[str], None], answer_s: float = ANSWER_S) -> bool:
        """Ask, and tell in a line each what came of it and after how long; whether it was obeyed."""
        began_ns = self._clock.now_ns()
        reply = await self.ask(action, 1.0 if action is Action.KILL else answer_s)
        if reply:
            word = "acknowledged" if reply.accepted else "REFUSED"
            tell(f"{action}: {word} by the supervisor after {self._ms(began_ns)}: {reply.text}")
        else:
            tell(f"{action}: no answer from the supervisor within {self._ms(began_ns)}")
        if action in (Action.START, Action.RESUME):
            return reply is not None and reply.accepted
        how = await self.obeyed(action, began_ns) if reply or action is Action.KILL else ""
        tell(f"{action}: {how} after {self._ms(began_ns)}" if how else f"{action}: NOT OBEYED. {INSTEAD}")
        return bool(how)

    async def _repeat(self, request: OperatorRequest) -> None:
        while True:
            self._requests.publish(request)
            await asyncio.sleep(REPEAT_S)

    def _answer(self, request_id: int) -> OperatorReply | None:
        self._answers |= {reply.request_id: reply for reply in self._replies.drain()}
        return self._answers.pop(request_id, None)

    async def _when(self, shown: Callable[[], T | None], timeout_s: float) -> T | None:
        """What `shown` shows as soon as it shows something; None where it never does."""
        until_ns = self._clock.now_ns() + round(1e9 * timeout_s)
        while self._clock.now_ns() < until_ns:
            if found := shown():
                return found
            await asyncio.sleep(LOOK_S)
        return None

    def _backed_off(self, action: Action, since_ns: int) -> str:
        vehicle, sent, verdict = self._vehicle.value, self._setpoint.value, self._safety.value
        if vehicle and vehicle.stamp_ns > since_ns:
            if not vehicle.armed:
                return "the motors are off"
            if vehicle.mode in (FlightMode.LAND, FlightMode.DESCEND):
                return "the autopilot lands"
        if sent is None or verdict is None or verdict.level < RAISES[action]:
            return ""
        if sent.stamp_ns > since_ns and sent.kind in KINDS[action]:
            return f"the bridge flies {sent.kind}"
        return ""

    def _motors_off(self) -> str:
        vehicle = self._vehicle.value
        return "the motors are off" if vehicle and vehicle.valid and not vehicle.armed else ""

    def _ms(self, since_ns: int) -> str:
        return f"{(self._clock.now_ns() - since_ns) * 1e-6:.0f} ms"


def command(action: Action, profile: str) -> int:
    """One command from a terminal: 0 when it was obeyed, 1 when not or when nobody answered, 2 for bad configuration."""
    try:
        config = load(profile)
        with told_in(profile):
            buses = observer_bus(config)
    except ConfigError as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2

    async def give() -> bool:
        with open_bus(buses, f"operator-{os.getpid()}") as bus:
            operator = Operator(operator_node(bus, clock_of(config, bus), buses.placement))
            return await operator.command(action, lambda text: print(text, flush=True))  # noqa: T201

    try:
        return 0 if asyncio.run(give()) else 1
    except KeyboardInterrupt:
        return 130
