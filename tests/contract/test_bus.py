"""One specification of a bus, run on both; then what is particular to Zenoh."""

# Zenoh's stubs leave some return types open.
# pyright: reportUnknownLambdaType=false

import asyncio
import threading
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import replace
from itertools import pairwise

import pytest
import zenoh

from schemas.topics import BY_KEY, GUIDANCE, HANDLE_STATE, HEALTH, SERVICES, TRUTH, Stance
from services.runtime.bus import Bus, MAX_PAYLOAD_bytes
from services.runtime.bus_config import AlreadyRunning, BusConfig, default_run_dir
from services.runtime.hosts import Placement
from services.runtime.memory_bus import MemoryBus
from services.runtime.packing import unpacker
from services.runtime.zenoh_bus import DEPTH, open_bus

Ends = Callable[[], AbstractAsyncContextManager[tuple[Bus, Bus]]]

KEY, OTHER = HANDLE_STATE.key, TRUTH.key
PATIENCE_s = 20.0


@pytest.fixture
def config(tmp_path):
    return BusConfig(system="test", run_dir=str(tmp_path), services=SERVICES)


@pytest.fixture(params=["memory", "zenoh"])
def ends(request, config):
    """An async context manager that yields the sending and the receiving end of one bus."""

    @asynccontextmanager
    async def open_ends():
        if request.param == "memory":
            bus = MemoryBus()
            yield bus, bus
        else:
            with open_bus(config, "tracker") as sender, open_bus(config, "recorder") as receiver:
                yield sender, receiver

    return open_ends


async def arrival(receiver_saw: Callable[[], object], send: Callable[[], object]):
    """Send until it is seen: a link that is being built may lose the first."""
    async with asyncio.timeout(PATIENCE_s):
        while not receiver_saw():
            send()
            await asyncio.sleep(0.02)


def test_a_put_arrives_unchanged_in_the_loops_thread(ends: Ends):
    async def main():
        seen = list[tuple[str, bytes, int]]()
        async with ends() as (sender, receiver):
            receiver.subscribe(KEY, lambda key, payload: seen.append((key, payload, threading.get_ident())))
            await arrival(lambda: seen, lambda: sender.put(KEY, b'{"x": 1}', Stance.STREAM))
        assert set(seen) == {(KEY, b'{"x": 1}', threading.get_ident())}

    asyncio.run(main())


def test_nothing_is_delivered_within_the_put_and_nobody_needs_to_listen(ends: Ends):
    async def main():
        seen = list[tuple[str, bytes]]()
        async with ends() as (sender, _):
            sender.put(OTHER, b"unheard", Stance.BULK)
            sender.subscribe(KEY, lambda key, payload: seen.append((key, payload)))
            sender.put(KEY, b"x", Stance.STREAM)
            assert seen == []
            await arrival(lambda: seen, lambda: None)

    asyncio.run(main())


def test_a_mailbox_keeps_what_arrives_until_it_is_asked(ends: Ends):
    async def main():
        seen = list[tuple[str, bytes]]()
        async with ends() as (sender, receiver):
            take = receiver.mailbox(KEY)
            await arrival(lambda: seen.extend(take()) or seen, lambda: sender.put(KEY, b"0", Stance.STATE))
            seen.clear()
            for n in range(1, 50):
                sender.put(KEY, b"%d" % n, Stance.STATE)
            await arrival(lambda: seen.extend(take()) or (KEY, b"49") in seen, lambda: None)
        numbers = [int(payload) for key, payload in seen if key == KEY]
        assert numbers == sorted(numbers)
        assert set(range(1, 50)) <= set(numbers)

    asyncio.run(main())


def test_samples_of_one_key_keep_their_order(ends: Ends):
    async def main():
        seen = list[int]()
        async with ends() as (sender, receiver):
            receiver.subscribe(KEY, lambda _, payload: seen.append(int(payload)))
            await arrival(lambda: seen, lambda: sender.put(KEY, b"0", Stance.STATE))
            for n in range(1, 200):
                sender.put(KEY, b"%d" % n, Stance.STATE)
            await arrival(lambda: seen[-1] == 1000, lambda: sender.put(KEY, b"1000", Stance.STATE))
        assert seen == sorted(seen)
        assert len(set(seen)) > 2

    asyncio.run(main())


def test_each_subscriber_gets_its_key_and_no_other(ends: Ends):
    async def main():
        first, second, other = list[str](), list[str](), list[str]()
        async with ends() as (sender, receiver):
            receiver.subscribe(KEY, lambda key, _: first.append(key))
            receiver.subscribe(KEY, lambda key, _: second.append(key))
            receiver.subscribe(OTHER, lambda key, _: other.append(key))
            await arrival(lambda: first and second, lambda: sender.put(KEY, b"a", Stance.STREAM))
            await arrival(lambda: other, lambda: sender.put(OTHER, b"b", Stance.BULK))
        assert (set(first), set(second), set(other)) == ({KEY}, {KEY}, {OTHER})

    asyncio.run(main())


def test_a_monster_arrives_as_no_message(ends: Ends):
    async def main():
        seen = list[bytes]()
        async with ends() as (sender, receiver):
            receiver.subscribe(KEY, lambda _, payload: seen.append(payload))
            await arrival(lambda: seen, lambda: sender.put(KEY, b"x" * (MAX_PAYLOAD_bytes + 1), Stance.STATE))
            await arrival(lambda: seen[-1], lambda: sender.put(KEY, b"x" * MAX_PAYLOAD_bytes, Stance.STATE))
        assert {len(payload) for payload in seen} == {0, MAX_PAYLOAD_bytes}

    asyncio.run(main())


def test_memory_bus_delays_and_cuts_single_keys():
    async def main():
        seen = list[str]()
        bus = MemoryBus(latency_s={KEY: 0.05})
        bus.cut.add(HEALTH["tracker"].key)
        for key in (KEY, OTHER, HEALTH["tracker"].key):
            bus.subscribe(key, lambda key, _: seen.append(key))
            bus.put(key, b"x", Stance.STREAM)
        await asyncio.sleep(0.2)
        assert seen == [OTHER, KEY]

    asyncio.run(main())


@asynccontextmanager
async def stranger(config: BusConfig, seen: list[tuple[str, bytes]]):
    """A bus that listens to KEY, and a foreign Zenoh session that reaches it."""
    foreign = zenoh.Config()
    foreign.insert_json5("listen/endpoints", "[]")
    foreign.insert_json5("connect/endpoints", f'["unixsock-stream/{config.socket("recorder")}"]')
    foreign.insert_json5("scouting/multicast/enabled", "false")
    with open_bus(config, "recorder") as bus, zenoh.open(foreign) as session:
        bus.subscribe(KEY, lambda key, payload: seen.append((key, payload)))
        yield bus, session


def test_zenoh_delete_and_wildcard_puts_can_be_told_from_messages(config: BusConfig):
    async def main():
        seen = list[tuple[str, bytes]]()
        async with stranger(config, seen) as (_, session):
            await arrival(lambda: (KEY, b"") in seen, lambda: session.delete(config.prefix + KEY))
            await arrival(lambda: ("**", b"{}") in seen, lambda: session.put(config.prefix + "**", b"{}"))

    asyncio.run(main())


def test_zenoh_carries_the_message_type_and_the_stance(config: BusConfig):
    async def main():
        samples = list[zenoh.Sample]()
        async with stranger(config, []) as (bus, session):
            session.declare_subscriber(f"{config.prefix}**", samples.append)
            await arrival(lambda: samples, lambda: bus.put(KEY, b"{}", Stance.STREAM))
        return samples[0]

    sample = asyncio.run(main())
    assert str(sample.encoding) == "application/json;HandleState"
    assert sample.priority == zenoh.Priority.INTERACTIVE_LOW
    assert sample.congestion_control == zenoh.CongestionControl.DROP


def test_zenoh_says_guidance_again_beside_the_next_where_there_is_a_radio_and_a_reader_takes_it_once(config: BusConfig):
    said = [b"%d" % n for n in range(20)]

    async def main(elsewhere: tuple[str, ...]):
        raw, seen = list[zenoh.Sample](), list[bytes]()
        config_here = replace(config, placement=Placement(here="drone", elsewhere=elsewhere))
        async with stranger(config_here, []) as (bus, session):
            session.declare_subscriber(config.prefix + GUIDANCE.key, raw.append)
            take = bus.mailbox(GUIDANCE.key)
            await arrival(lambda: raw, lambda: bus.put(GUIDANCE.key, b"first", GUIDANCE.stance))
            for payload in said:
                bus.put(GUIDANCE.key, payload, GUIDANCE.stance)
            async with asyncio.timeout(PATIENCE_s):
                while b"19" not in seen[-1:]:
                    await asyncio.sleep(0.02)
                    seen += [payload for _, payload in take() if payload != b"first"]
        return seen, [(s.payload.to_bytes(), s.priority) for s in raw][-len(said) :]

    seen, packets = asyncio.run(main(()))
    assert seen == said
    assert packets == [(payload, zenoh.Priority.REAL_TIME) for payload in said], "once and as it is, on one host"
    seen, packets = asyncio.run(main(("guiding_controller",)))
    assert seen == said
    brought = [(unpacker(GUIDANCE)(packet), priority) for packet, priority in packets]
    assert sorted(payloads for payloads, _ in brought) == sorted(map(list, pairwise((b"first", *said))))
    for payload in said[:-1]:
        links = [priority for payloads, priority in brought if payload in payloads]
        assert zenoh.Priority.REAL_TIME in links
        assert zenoh.Priority.INTERACTIVE_HIGH in links, "one link, or one packet, may fail"


def test_zenoh_a_stuck_loop_keeps_the_newest_and_counts_the_rest(config: BusConfig):
    async def main():
        seen, n = list[int](), 2 * DEPTH
        with open_bus(config, "recorder") as bus:
            bus.subscribe(KEY, lambda _, payload: seen.append(int(payload)))
            flood = threading.Thread(target=lambda: [bus.put(KEY, b"%d" % i, Stance.STATE) for i in range(n)])
            flood.start()
            flood.join()  # the loop is stuck here
            await arrival(lambda: n in seen, lambda: bus.put(KEY, b"%d" % n, Stance.STATE))
            assert bus.dropped > 0
        assert len(set(seen)) + bus.dropped >= n
        assert seen == sorted(seen)

    asyncio.run(main())


def test_zenoh_presence_comes_and_goes(config: BusConfig):
    async def main():
        changes = list[tuple[str, bool]]()
        with open_bus(config, "cli-1") as watcher:
            watcher.watch(lambda name, alive: changes.append((name, alive)))
            with open_bus(config, "tracker"):
                await arrival(lambda: ("tracker", True) in changes, lambda: None)
                assert {"cli-1", "tracker"} <= watcher.alive()
            await arrival(lambda: ("tracker", False) in changes, lambda: None)

    asyncio.run(main())


def test_zenoh_a_name_is_held_once(config: BusConfig):
    with open_bus(config, "tracker"):
        with (
            pytest.raises(AlreadyRunning, match=r"service tracker of system test is already running \(pid \d+\)"),
            open_bus(config, "tracker"),
        ):
            pass
        with open_bus(config, "panel"), open_bus(config, "panel"):
            pass  # an observer is no service
    with open_bus(config, "tracker"):
        pass


def test_a_socket_path_beyond_the_kernels_limit_is_named(config: BusConfig):
    far = BusConfig(system="test", run_dir="/tmp/" + "x" * 100, services=SERVICES)
    message = r"run_dir: socket path /tmp/x+/test/\w+.sock has \d+ bytes, the limit is 107"
    with pytest.raises(ValueError, match=message), open_bus(far, "tracker"):
        pass


def test_the_default_folder_follows_the_environment(monkeypatch):
    monkeypatch.setenv("CLEW_RUN_DIR", "/somewhere")
    assert default_run_dir() == "/somewhere"
    monkeypatch.delenv("CLEW_RUN_DIR")
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/run/user/1")
    assert default_run_dir() == "/run/user/1/clew"
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert default_run_dir().startswith("/tmp/clew-")


def test_every_stance_of_the_table_can_be_carried(config: BusConfig):
    async def main():
        with open_bus(config, "observer") as bus:
            for topic in BY_KEY.values():
                bus.put(topic.key, b"{}", topic.stance)

    asyncio.run(main())
