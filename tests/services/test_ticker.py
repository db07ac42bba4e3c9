"""Ticks: no period is lost silently, on the kernel's timer and on virtual time."""

import asyncio
import itertools
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.runtime.clock import MonotonicClock
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node
from services.runtime.ticker import LoopStats, STALL_ns
from services.runtime.virtual import START_ns, VirtualClock, run_virtual


def collect(rate_Hz, count, body):
    """An async function that ticks `count` times and returns the ticks and the statistics."""

    async def main(clock):
        node, ticks = Node("nobody", MemoryBus(), clock), []
        async for tick in node.ticks(rate_Hz):
            ticks.append(tick)
            if len(ticks) == count:
                break
            await body(tick)
        return ticks, node.stats

    return main


async def idle(tick):
    pass


def test_virtual_ticks_are_exact():
    ticks, stats = run_virtual(collect(60.0, 600, idle)(VirtualClock()))
    period_ns = round(1e9 / 60.0)
    assert [tick.stamp_ns for tick in ticks] == [START_ns + (n + 1) * period_ns for n in range(600)]
    assert [tick.n for tick in ticks] == list(range(600))
    assert {(tick.dt_s, tick.missed) for tick in ticks} == {(1 / 60.0, 0)}
    assert (stats.missed, stats.stalls, stats.lateness_ms(0.99)) == (0, 0, 0.0)


@given(st.lists(st.integers(min_value=0, max_value=3000), min_size=1, max_size=20))
def test_virtual_ticks_account_for_all_time_whatever_the_body_takes(naps_ms):
    naps = iter(naps_ms)

    async def nap(tick):
        await asyncio.sleep(next(naps) * 1e-3)

    ticks, stats = run_virtual(collect(100.0, len(naps_ms) + 1, nap)(VirtualClock()))
    assert sum(tick.dt_s for tick in ticks) == pytest.approx((ticks[-1].stamp_ns - START_ns) * 1e-9)
    assert stats.missed == sum(tick.missed for tick in ticks) == len_periods(ticks) - len(ticks)
    assert stats.longest_stall_ns <= max(naps_ms) * 1_000_000


def len_periods(ticks):
    return (ticks[-1].stamp_ns - START_ns) // 10_000_000


def test_real_ticks_count_the_periods_missed_by_a_blocked_loop():
    blocked_ns = []

    async def block_once(tick):
        if tick.n == 2:
            before = time.monotonic_ns()
            time.sleep(0.05)  # noqa: ASYNC251 - on purpose: the loop hangs
            blocked_ns.append(time.monotonic_ns() - before)

    ticks, stats = asyncio.run(collect(200.0, 6, block_once)(MonotonicClock()))
    late = ticks[3]
    assert late.missed >= 3
    assert late.missed >= blocked_ns[0] // 5_000_000 - 1
    assert late.dt_s == (1 + late.missed) / 200.0
    assert stats.missed == sum(tick.missed for tick in ticks)
    assert stats.longest_stall_ns >= (late.missed - 1) * 5_000_000


def test_real_ticks_lose_no_period():
    ticks, _ = asyncio.run(collect(500.0, 100, idle)(MonotonicClock()))
    steps = [(new.stamp_ns - old.stamp_ns, 1 + new.missed) for old, new in itertools.pairwise(ticks)]
    assert all(step == periods * 2_000_000 for step, periods in steps)
    assert [tick.n for tick in ticks] == list(range(100))


def test_ticks_that_wait_elsewhere_count_too():
    async def wait_elsewhere(tick):
        await asyncio.sleep(0.03)

    ticks, _ = asyncio.run(collect(200.0, 5, wait_elsewhere)(MonotonicClock()))
    assert all(tick.missed >= 3 for tick in ticks[1:])


def test_a_tick_never_comes_before_its_time():
    async def main():
        node, early = Node("nobody", MemoryBus(), MonotonicClock()), 0
        async for tick in node.ticks(500.0):
            early += node.clock.now_ns() < tick.stamp_ns
            if tick.n == 100:
                break
        return early

    assert asyncio.run(main()) == 0


def test_a_stall_is_what_is_later_than_the_threshold():
    stats = LoopStats()
    for late_ns in (0, STALL_ns, STALL_ns + 1, 5):
        stats.note(late_ns, 0)
    assert (stats.stalls, stats.longest_stall_ns, stats.turns) == (1, STALL_ns + 1, 4)
    assert stats.lateness_ms(0.5) == pytest.approx(STALL_ns * 1e-6)
