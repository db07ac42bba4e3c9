"""What crosses a radio packed comes out as it went in, once, though packets are lost; what is not packed so does not."""

import zlib
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.message import Vec3
from schemas.topics import GUIDANCE, HANDLE_STATE, ROBOT_POSE, TOPICS, Stance
from schemas.tracking import HandleSource, HandleState
from services.config import load
from services.runtime.bus import MAX_PAYLOAD_bytes
from services.runtime.packing import BETWEEN, packer, unpacker

PAYLOADS = st.lists(st.binary(min_size=1, max_size=60).filter(lambda b: BETWEEN not in b), min_size=1, unique=True)
CONFIG = load("ground-sim")


@given(PAYLOADS, st.data())
def test_nothing_is_missed_while_no_two_packets_in_a_row_are_lost(payloads: list[bytes], data: st.DataObject):
    lost = data.draw(st.sets(st.integers(0, len(payloads) - 2))) if len(payloads) > 1 else set[int]()
    lost -= {b for a, b in pairwise(sorted(lost)) if b == a + 1}
    pack, unpack = packer(GUIDANCE), unpacker(GUIDANCE)
    packets = [pack(payload) for payload in payloads]
    kept = [packet for n, packet in enumerate(packets) if n not in lost]
    assert [payload for packet in kept for payload in unpack(packet)] == payloads


@given(PAYLOADS)
def test_what_goes_once_comes_once_even_where_it_is_repeated(payloads: list[bytes]):
    pack, unpack = packer(ROBOT_POSE), unpacker(ROBOT_POSE)
    assert [unpack(pack(payload)) for payload in payloads * 2] == [[payload] for payload in payloads * 2]


def test_a_message_is_packed_into_less_than_half():
    third = Vec3(x=1 / 3, y=-2 / 3, z=10 / 3)
    said = HandleState(stamp_ns=10**15, position_m=third, velocity_mps=third, source=HandleSource.MOCAP, lag_s=0.06)
    payload = said.model_dump_json().encode()
    assert len(packer(HANDLE_STATE)(payload)) < 0.5 * len(payload)


@pytest.mark.parametrize(
    "packet",
    [
        b"",
        b'{"seq": 1}',
        packer(HANDLE_STATE)(b'{"seq": 1}'),
        packer(GUIDANCE)(b'{"seq": 1}')[:-1],
        zlib.compress(b'{"seq": 1}'),
        packer(GUIDANCE)(b" " * (3 * MAX_PAYLOAD_bytes)),
    ],
    ids=["deleted", "plain", "another type's", "cut off", "without the names", "a bomb"],
)
def test_what_is_not_packed_as_its_topic_is_no_message(packet: bytes):
    assert unpacker(GUIDANCE)(packet) == [b""]


def test_the_table_packs_what_flies_by_the_radio_and_nothing_that_does_not_cross_it_whole():
    for topic in TOPICS:
        host = CONFIG.host_of(topic.publisher)
        crosses = any(CONFIG.host_of(name) not in (host, "") for name in topic.subscribers)
        assert topic.packed is (crosses and topic.rate_Hz >= 50.0 and not topic.radio_Hz), topic.key
        assert topic.packed or topic.stance is not Stance.TWICE
