"""Virtual time: exact, ordered, repeatable, and it says when nothing can happen any more."""

import asyncio
import time
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.message import Vec3
from schemas.topics import HANDLE_STATE, HEALTH
from schemas.tracking import HandleSource, HandleState
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node
from services.runtime.virtual import Deadlock, START_ns, VirtualClock, run_virtual


def test_a_day_passes_at_once_and_exactly():
    async def main():
        await asyncio.sleep(86_400.0)
        return VirtualClock().now_ns()

    before = time.monotonic()
    assert run_virtual(main(), limit_s=1e6) == START_ns + 86_400_000_000_000
    assert time.monotonic() - before < 3600.0


def test_time_stands_still_while_code_runs():
    async def main():
        clock = VirtualClock()
        before = clock.now_ns()
        for _ in range(100):
            await asyncio.sleep(0)
        return clock.now_ns() - before

    assert run_virtual(main()) == 0


@given(st.lists(st.integers(min_value=0, max_value=5), max_size=30))
def test_timers_fire_by_time_then_in_the_order_of_their_making(delays):
    async def main():
        fired = []
        for n, delay in enumerate(delays):
            asyncio.get_running_loop().call_later(delay, fired.append, (delay, n))
        await asyncio.sleep(10.0)
        return fired

    assert run_virtual(main()) == sorted((delay, n) for n, delay in enumerate(delays))


def test_what_one_timer_sets_off_is_finished_before_the_next_of_the_same_time():
    async def main():
        order = []

        async def chain(name):
            await asyncio.sleep(1.0)
            for step in range(3):
                order.append((name, step))
                await asyncio.sleep(0)

        await asyncio.gather(chain("a"), chain("b"))
        return order

    assert run_virtual(main()) == [(name, step) for name in "ab" for step in range(3)]


def test_a_cancelled_timer_never_fires():
    async def main():
        loop, fired = asyncio.get_running_loop(), []
        second = loop.call_later(1.0, fired.append, "second")
        loop.call_later(1.0, fired.append, "third")
        loop.call_later(0.5, second.cancel)
        await asyncio.sleep(2.0)
        return fired

    assert run_virtual(main()) == ["third"]


def test_timeouts_are_virtual_too():
    async def main():
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(60.0):
                await asyncio.Event().wait()
        return VirtualClock().now_ns()

    assert run_virtual(main()) == START_ns + 60_000_000_000


def test_nothing_scheduled_is_a_clear_error():
    async def main():
        await asyncio.sleep(2.0)
        await asyncio.create_task(asyncio.Event().wait(), name="the one that waits")

    with pytest.raises(Deadlock, match=r"nothing is scheduled at 3\.000 s; waiting: .*the one that waits"):
        run_virtual(main())


def test_an_endless_run_ends_at_its_limit():
    async def main():
        while True:  # noqa: ASYNC110 - on purpose
            await asyncio.sleep(1.0)

    with pytest.raises(TimeoutError, match="not finished at 11"):
        run_virtual(main(), limit_s=10.0)


def test_errors_come_out_as_they_are():
    async def main():
        await asyncio.sleep(1.0)
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        run_virtual(main())


def test_two_runs_of_a_system_send_the_same_bytes():
    async def main():
        bus, sent = MemoryBus(latency_s={HANDLE_STATE.key: 0.004}), list[tuple[int, str, bytes]]()
        for topic in (HANDLE_STATE, HEALTH["tracker"], HEALTH["guiding_controller"]):
            bus.subscribe(topic.key, lambda key, payload: sent.append((VirtualClock().now_ns(), key, payload)))

        async def track(node: Node):
            publisher = node.publisher(HANDLE_STATE)
            async for tick in node.ticks(60.0):
                p_H = Vec3(x=tick.n / 7)
                publisher.publish(
                    HandleState(position_m=p_H, velocity_mps=Vec3(), source=HandleSource.MOCAP, lag_s=0.0)
                )

        async def guide(node: Node):
            async for _ in node.stream(HANDLE_STATE):
                pass

        tasks = [track(Node("tracker", bus, VirtualClock())), guide(Node("guiding_controller", bus, VirtualClock()))]
        with suppress(TimeoutError):
            async with asyncio.timeout(5.0):
                await asyncio.gather(*tasks)
        return sent

    first = run_virtual(main())
    assert len(first) > 300
    assert run_virtual(main()) == first


def test_the_virtual_clock_wants_the_virtual_loop():
    async def main():
        return VirtualClock().now_ns()

    with pytest.raises(AssertionError, match="run_virtual"):
        asyncio.run(main())
