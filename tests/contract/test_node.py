"""The typed layer: what it refuses, what it counts, when a message is too old."""

import asyncio
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.message import Vec3
from schemas.safety import Action, OperatorReply, OperatorRequest
from schemas.topics import HANDLE_STATE, OPERATOR, REPLY, REQUEST, TRUTH, VEHICLE_IMU
from schemas.tracking import HandleSource, HandleState
from services.runtime.bus import MAX_PAYLOAD_bytes
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node, used
from services.runtime.virtual import START_ns, VirtualClock, run_virtual

HANDLE = HandleState(
    position_m=Vec3(x=0.1, y=1 / 3),
    velocity_mps=Vec3(),
    source=HandleSource.MOCAP,
    lag_s=0.01,
    inputs={"mocap/frame": 7},
)
REQUESTED = OperatorRequest(action=Action.START, operator="anna", request_id=1)


def pair():
    """A bus with the tracker, which writes handle/state, and the guiding controller, which reads it."""
    bus = MemoryBus()
    return bus, Node("tracker", bus, VirtualClock()), Node("guiding_controller", bus, VirtualClock())


def payload(**changes):
    return json.dumps(json.loads(HANDLE.model_dump_json()) | {"seq": 1, "stamp_ns": START_ns} | changes).encode()


def test_what_is_published_is_what_is_read():
    async def main():
        _, tracker, guiding = pair()
        reader = guiding.latest(HANDLE_STATE)
        assert (reader.message, reader.value, reader.received_ns, reader.fresh) == (None, None, 0, False)
        assert reader.age_s == float("inf")
        await asyncio.sleep(1.0)
        sent = tracker.publisher(HANDLE_STATE).publish(HANDLE)
        await asyncio.sleep(0.001)
        header = {"seq": 1, "stamp_ns": START_ns + 1_000_000_000, "said_ns": START_ns + 1_000_000_000}
        assert reader.message == sent == HANDLE.model_copy(update=header)
        assert reader.value is reader.message
        assert used(reader) == {"handle/state": 1}
        assert guiding.received == {"handle/state": 1}

    run_virtual(main())


def test_seq_counts_and_a_given_stamp_is_kept():
    async def main():
        _, tracker, _ = pair()
        publish = tracker.publisher(HANDLE_STATE).publish
        assert [publish(HANDLE).seq, publish(HANDLE).seq] == [1, 2]
        assert publish(HANDLE.model_copy(update={"stamp_ns": 5})).stamp_ns == 5
        assert tracker.publisher(HANDLE_STATE).publish(HANDLE).seq == 4  # one writer in a node, one count

    run_virtual(main())


BAD = {
    "garbage": b"\xff\x00{",
    "no JSON": b"hello",
    "not an object": b"[1, 2]",
    "empty, as a DELETE arrives": b"",
    "NaN": payload().replace(b"0.01", b"NaN"),
    "infinity": payload().replace(b"0.01", b"Infinity"),
    "a number too large": payload().replace(b"0.01", b"1e999"),
    "a string for a number": payload(lag_s="0.01"),
    "null": payload(lag_s=None),
    "an extra field": payload(surprise=1),
    "a missing field": payload().replace(b'"lag_s"', b'"lag"'),
    "an unknown choice": payload(source="guess"),
    "another message's type": REQUESTED.model_dump_json().encode(),
    "no seq": payload(seq=0),
    "a negative seq": payload(seq=-1),
    "oversize": payload(invalid_reason="x" * MAX_PAYLOAD_bytes),
    "nested beyond reason": payload().replace(b"0.01", b"[" * 20_000 + b"]" * 20_000),
}


@pytest.mark.parametrize("why", BAD)
def test_bad_input_is_counted_and_never_delivered(why):
    async def main():
        bus, _, guiding = pair()
        latest, stream = guiding.latest(HANDLE_STATE), guiding.stream(HANDLE_STATE)
        bus.put("handle/state", BAD[why], HANDLE_STATE.stance)
        await asyncio.sleep(0.01)
        assert (latest.message, stream.drain()) == (None, [])
        assert (guiding.rejected["handle/state"], guiding.received["handle/state"]) == (1, 0)
        bus.put("handle/state", payload(), HANDLE_STATE.stance)
        await asyncio.sleep(0.01)
        assert latest.fresh

    run_virtual(main())


@given(st.binary(max_size=200))
def test_no_bytes_can_raise(noise):
    async def main():
        bus, _, guiding = pair()
        latest = guiding.latest(HANDLE_STATE)
        bus.put("handle/state", noise, HANDLE_STATE.stance)
        await asyncio.sleep(0.01)
        assert latest.message is None
        assert guiding.rejected["handle/state"] == 1

    run_virtual(main())


class WildcardBus(MemoryBus):
    """Delivers as Zenoh does when somebody puts on a wildcard: with the key of the put."""

    def subscribe(self, key, on_payload):
        super().subscribe(key, lambda _, payload: on_payload("**", payload))


def test_a_put_on_a_wildcard_is_refused():
    async def main():
        bus = WildcardBus()
        guiding = Node("guiding_controller", bus, VirtualClock())
        latest = guiding.latest(HANDLE_STATE)
        bus.put("handle/state", payload(), HANDLE_STATE.stance)
        await asyncio.sleep(0.01)
        assert latest.message is None
        assert guiding.rejected["handle/state"] == 1

    run_virtual(main())


def deliver(*samples):
    """What a reader holds after (seq, stamp in ms, wait in s) arrive; and its node."""

    async def main():
        bus, _, guiding = pair()
        latest, held = guiding.latest(HANDLE_STATE), []
        for seq, stamp_ms, wait_s in samples:
            await asyncio.sleep(wait_s)
            bus.put("handle/state", payload(seq=seq, stamp_ns=START_ns + stamp_ms * 1_000_000), HANDLE_STATE.stance)
            await asyncio.sleep(0.001)
            held.append(latest.message.seq if latest.message else 0)
        return held, guiding.rejected["handle/state"], guiding.restarts["handle/state"]

    return run_virtual(main())


def test_seq_must_rise():
    assert deliver((5, 0, 0), (5, 0, 0), (4, -1, 0), (7, 1, 0)) == ([5, 5, 5, 7], 2, 0)


def test_a_publisher_may_restart():
    assert deliver((500, 0, 0), (1, 10, 0), (2, 20, 0)) == ([500, 1, 2], 0, 1)
    assert deliver((1, 0, 0), (1, 10, 0)) == ([1, 1], 0, 1)  # a console that asks once, twice
    assert deliver((500, 9000, 0), (3, 10, 2.0)) == ([500, 3], 0, 1)  # after a silence: its host restarted


def test_the_table_says_who_may_write_and_read():
    bus = MemoryBus()
    guiding = Node("guiding_controller", bus, VirtualClock())
    with pytest.raises(ValueError, match="guiding_controller may not publish handle/state: the table names tracker"):
        guiding.publisher(HANDLE_STATE)
    with pytest.raises(
        ValueError, match="guiding_controller may not read vehicle/imu: the table lists force_estimator"
    ):
        guiding.latest(VEHICLE_IMU)
    with pytest.raises(ValueError, match="guiding_controller may not read sim/truth"):
        guiding.stream(TRUTH)
    Node("recorder", bus, VirtualClock(), observer=True).stream(TRUTH)
    Node(OPERATOR, bus, VirtualClock(), observer=True).publisher(REQUEST)


def test_staleness_follows_the_table():
    async def main():
        _, tracker, guiding = pair()
        reader = guiding.latest(HANDLE_STATE)
        tracker.publisher(HANDLE_STATE).publish(HANDLE)
        await asyncio.sleep(HANDLE_STATE.timeout_s - 0.001)
        assert reader.fresh
        await asyncio.sleep(0.002)
        assert not reader.fresh
        assert reader.value is None
        assert reader.message is not None
        assert reader.age_s == pytest.approx(HANDLE_STATE.timeout_s + 0.001)

    run_virtual(main())


@pytest.mark.parametrize("offset_s", [-0.2, 0.2])
def test_a_stamp_far_from_now_is_not_fresh_however_new_the_arrival(offset_s):
    async def main():
        _, tracker, guiding = pair()
        reader = guiding.latest(HANDLE_STATE)
        stamp_ns = tracker.clock.now_ns() + round(offset_s * 1e9)
        tracker.publisher(HANDLE_STATE).publish(HANDLE.model_copy(update={"stamp_ns": stamp_ns}))
        await asyncio.sleep(0.001)
        assert reader.message is not None
        assert not reader.fresh

    run_virtual(main())


def test_an_invalid_message_is_held_but_not_fresh():
    async def main():
        _, tracker, guiding = pair()
        reader = guiding.latest(HANDLE_STATE)
        tracker.publisher(HANDLE_STATE).publish(HANDLE.model_copy(update={"valid": False, "invalid_reason": "hidden"}))
        await asyncio.sleep(0.001)
        assert reader.message is not None
        assert reader.message.invalid_reason == "hidden"
        assert reader.value is None

    run_virtual(main())


def test_what_comes_on_demand_is_never_stale():
    async def main():
        bus = MemoryBus()
        reader = Node(OPERATOR, bus, VirtualClock()).latest(REPLY)
        answer = OperatorReply(request_id=1, accepted=True, text="phase takeoff")
        Node("safety_supervisor", bus, VirtualClock()).publisher(REPLY).publish(answer)
        await asyncio.sleep(1000.0)
        assert reader.fresh

    run_virtual(main())


def test_a_stream_keeps_order_and_drops_the_oldest():
    async def main():
        _, tracker, guiding = pair()
        stream, publisher = guiding.stream(HANDLE_STATE, depth=3), tracker.publisher(HANDLE_STATE)
        for _ in range(5):
            publisher.publish(HANDLE)
        await asyncio.sleep(0.001)
        assert used(stream) == {}  # nothing is used before it is taken
        assert [message.seq for message in stream.drain()] == [3, 4, 5]
        assert (stream.overflowed, guiding.rejected["handle/state"]) == (2, 2)
        assert used(stream) == {"handle/state": 5}
        assert stream.drain() == []
        assert stream.message is not None

    run_virtual(main())


def test_a_stream_waits_and_names_what_was_taken():
    async def main():
        _, tracker, guiding = pair()
        stream, taken = guiding.stream(HANDLE_STATE), []

        async def read():
            async for message in stream:
                taken.append((message.seq, used(stream)["handle/state"]))

        task = asyncio.create_task(read())
        for burst in (1, 3, 2):
            await asyncio.sleep(3.0)
            for _ in range(burst):
                tracker.publisher(HANDLE_STATE).publish(HANDLE)
        await asyncio.sleep(0.1)
        task.cancel()
        assert taken == [(n, n) for n in range(1, 7)]

    run_virtual(main())


def test_readers_of_one_topic_share_one_decoding():
    async def main():
        _, tracker, guiding = pair()
        latest, stream = guiding.latest(HANDLE_STATE), guiding.stream(HANDLE_STATE)
        tracker.publisher(HANDLE_STATE).publish(HANDLE)
        await asyncio.sleep(0.001)
        assert latest.message is stream.drain()[0]

    run_virtual(main())
