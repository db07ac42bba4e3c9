"""Health is the word of the service's own loop: it beats while the loop turns, and only then."""

import asyncio
import socket

import pytest

from schemas.topics import HANDLE_STATE, HEALTH, OPERATOR
from services.runtime import watchdog
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node
from services.runtime.virtual import VirtualClock, run_virtual


async def heartbeats(service, seconds):
    """What an operator hears of a service while it runs."""
    bus = MemoryBus()
    node = Node("guiding_controller", bus, VirtualClock())
    stream = Node(OPERATOR, bus, VirtualClock(), observer=True).stream(HEALTH["guiding_controller"])
    node.status = "well"
    task = asyncio.create_task(service(node))
    await asyncio.sleep(seconds)
    task.cancel()
    return stream.drain()


def test_a_ticking_service_beats_with_its_rate():
    async def service(node):
        async for _ in node.ticks(100.0):
            pass

    beats = run_virtual(heartbeats(service, 3.2))
    assert 6 <= len(beats) <= 7
    assert beats[-1].loop_rate_Hz == pytest.approx(100.0)
    assert (beats[-1].service, beats[-1].status, beats[-1].missed_periods) == ("guiding_controller", "well", 0)


def test_a_service_that_waits_for_messages_beats_all_the_same():
    async def service(node):
        async for _ in node.stream(HANDLE_STATE):
            pass

    assert len(run_virtual(heartbeats(service, 3.2))) >= 6


def test_a_hung_service_is_silent():
    async def service(node):
        async for tick in node.ticks(100.0):
            if tick.n == 100:
                await asyncio.Event().wait()

    assert len(run_virtual(heartbeats(service, 10.0))) <= 3


def test_a_rejection_is_seen_in_the_heartbeat():
    async def service(node):
        node.reject("handle/state", "for the test")
        async for _ in node.ticks(10.0):
            pass

    assert run_virtual(heartbeats(service, 1.0))[-1].rejected == {"handle/state": 1}


def test_the_service_managers_watchdog_is_fed_by_the_loop_itself(tmp_path, monkeypatch):
    async def turn(seconds: float):
        async for tick in Node("tracker", MemoryBus(), VirtualClock()).ticks(100.0):
            if tick.n >= 100.0 * seconds:
                break

    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        run_virtual(turn(3.2))
        fed = 0
        while True:
            try:
                assert b"WATCHDOG=1" in manager.recv(100)
            except BlockingIOError:
                break
            fed += 1
    assert fed == 7  # at once, then twice a second


def test_a_service_manager_that_does_not_listen_stops_nobody(monkeypatch):
    monkeypatch.setenv("NOTIFY_SOCKET", "@nobody")
    watchdog.feed()
