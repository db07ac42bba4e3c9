"""Several consoles, one topic: each counts its own messages, by a clock that is a little off, and all are heard."""

import asyncio

from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.safety import Action, OperatorRequest
from schemas.topics import OPERATOR, REQUEST
from services.console.operator import REPEAT_S
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node
from services.runtime.virtual import VirtualClock, run_virtual

LATER_S = 1.0


class OffClock(VirtualClock):
    """A console's idea of the ground's clock."""

    def __init__(self, off_s: float) -> None:
        self._off_ns = round(off_s * 1e9)

    def now_ns(self) -> int:
        return super().now_ns() + self._off_ns


@settings(max_examples=30, deadline=None)
@given(
    off_s=st.floats(-0.015, 0.015),
    said_before=st.integers(0, 500),
    phase_s=st.floats(0.0, REPEAT_S),
    first=st.booleans(),
)
def test_two_consoles_that_repeat_at_once_are_both_heard_within_a_few_repeats(off_s, said_before, phase_s, first):
    """One has said much and one nothing; whichever clock is ahead, the other's command comes through."""
    waited: dict[str, float] = {}

    async def main() -> None:
        bus, clock, began_s = MemoryBus(), VirtualClock(), asyncio.get_running_loop().time()
        requests = Node("safety_supervisor", bus, clock).queue(REQUEST)

        async def repeat(who: str, off: float, start_s: float, already: int) -> None:
            out = Node(OPERATOR, bus, OffClock(off), observer=True).publisher(REQUEST)
            out.seq = already
            await asyncio.sleep(start_s)
            while who not in waited or start_s < LATER_S:
                out.publish(OperatorRequest(action=Action.HOLD, operator=who, request_id=1))
                await asyncio.sleep(REPEAT_S)

        async def listen() -> None:
            while "late" not in waited:
                for request in requests.drain():
                    waited.setdefault(request.operator, asyncio.get_running_loop().time() - began_s)
                await asyncio.sleep(0.005)

        talker = asyncio.create_task(repeat("early", off_s, 0.0, said_before if first else 0))
        newcomer = asyncio.create_task(repeat("late", 0.0, LATER_S + phase_s, 0 if first else said_before))
        async with asyncio.timeout(LATER_S + 2.0):
            await listen()
        talker.cancel()
        newcomer.cancel()

    run_virtual(main())
    assert waited["late"] - LATER_S - phase_s < 4.0 * REPEAT_S
