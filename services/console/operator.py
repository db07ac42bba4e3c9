"""The operator's side of the bus: a command is repeated until the supervisor has answered it."""

import asyncio
import itertools
import os
import socket

from schemas.safety import Action, OperatorReply, OperatorRequest
from schemas.topics import OPERATOR, REPLY, REQUEST
from services.runtime.bus import Bus
from services.runtime.clock import Clock
from services.runtime.hosts import Placement
from services.runtime.node import Node

REPEAT_S = 0.2


def operator_node(bus: Bus, clock: Clock, placement: Placement | None = None) -> Node:
    """A node that may read everything and write requests."""
    return Node(OPERATOR, bus, clock, observer=True, placement=placement)


class Operator:
    """One person's commands over one node."""

    def __init__(self, node: Node) -> None:
        self._requests, self._replies = node.publisher(REQUEST), node.stream(REPLY)
        self._ids = itertools.count(os.getpid() << 16)
        self.name = f"{os.environ.get('USER', 'operator')}@{socket.gethostname()}"

    async def ask(self, action: Action, timeout_s: float = 2.0) -> OperatorReply | None:
        """Send until answered; None where nobody answers within `timeout_s`."""
        request = OperatorRequest(action=action, operator=self.name, request_id=next(self._ids))
        repeats = asyncio.create_task(self._repeat(request))
        try:
            async with asyncio.timeout(timeout_s):
                async for reply in self._replies:
                    if reply.request_id == request.request_id:
                        return reply
        except TimeoutError:
            return None
        finally:
            repeats.cancel()
        return None

    async def _repeat(self, request: OperatorRequest) -> None:
        while True:
            self._requests.publish(request)
            await asyncio.sleep(REPEAT_S)
