"""A recording holds what was said, byte for byte, says what it lacks, and survives being cut off anywhere."""

import asyncio
import json
from functools import cache
from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from schemas.health import Heartbeat
from schemas.safety import Phase
from schemas.topics import BY_KEY, GUIDANCE, HANDLE_STATE, HEALTH, MOCAP_FRAME, REQUEST, SAFETY_STATE, TOPICS, Stance
from services.config import load
from services.recorder import service
from services.recorder.reading import read
from services.recorder.verdict import Count
from services.recorder.writer import SessionWriter, channel_name
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node
from services.runtime.virtual import VirtualClock, run_virtual
from tests.services import synthetic, synthetic_world

PARAMS = load("demo").recorder
SHORT = synthetic_world.Scenario(guiding_s=2.0)


@pytest.fixture(scope="module")
def said():
    return synthetic.samples(SHORT)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The bytes of a finished recording of many small chunks."""
    return Sized(synthetic.write(tmp_path_factory.mktemp("whole") / "session.mcap", SHORT).read_bytes())


def record(file: Path, samples, *, stop_after_s: float = 0.0):
    """Put the samples on a bus at virtual time while the recorder listens; then cancel it."""

    async def scene():
        bus = MemoryBus()
        node = Node("recorder", bus, VirtualClock())
        recording = service.record(
            node, bus, file=file, params=PARAMS, metadata={"profile": "test"}, attachments={"config.json": b"{}"}
        )
        task = asyncio.create_task(recording)
        start_ns = samples[0][2]
        for key, payload, stamp_ns in samples:
            await asyncio.sleep(max(0.0, (stamp_ns - start_ns) * 1e-9 - asyncio.get_running_loop().time() + 1.1))
            bus.put(key, payload, Stance.BULK)
        await asyncio.sleep(stop_after_s)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        return node

    return run_virtual(scene())


def test_everything_said_is_kept_byte_for_byte_even_what_arrives_after_the_last_tick(tmp_path, said):
    some = [sample for sample in said if sample[2] < said[0][2] + 3_000_000_000 and sample[0] != "health/recorder"]
    record(tmp_path / "a.mcap", some)
    session = read(tmp_path / "a.mcap")
    assert session.damage == ""
    assert session.verdict.closed
    assert session.verdict.lost == 0
    for key in {key for key, _, _ in some}:
        assert session.logs[key].payloads == [payload for k, payload, _ in some if k == key]
    assert session.attachments["config.json"] == b"{}"
    assert session.metadata["clew.session"]["profile"] == "test"


def test_the_recorder_says_in_its_heartbeat_what_it_holds(tmp_path, said):
    some = [sample for sample in said if sample[2] < said[0][2] + 3_000_000_000 and sample[0] == HANDLE_STATE.key]
    record(tmp_path / "a.mcap", [*some[:20], *some[30:]], stop_after_s=1.0)
    statuses = [beat.status for beat in read(tmp_path / "a.mcap").messages(HEALTH["recorder"])]
    assert "handle/state: 10 missing, 0 malformed" in statuses[-1]


def test_a_second_recording_does_not_overwrite_the_first(tmp_path, said):
    file = synthetic.write(tmp_path / "a.mcap", SHORT)
    before = file.read_bytes()
    with pytest.raises(FileExistsError):
        SessionWriter(file, TOPICS, epoch_ns=0, chunk_bytes=1000)
    assert file.read_bytes() == before


def test_gaps_restarts_and_malformed_samples_are_counted_by_topic(tmp_path):
    file = tmp_path / "a.mcap"
    with SessionWriter(file, TOPICS, epoch_ns=synthetic.EPOCH_NS, chunk_bytes=1000) as session:
        for seq in (5, 6, 9, 1, 2, 4):
            session.add(GUIDANCE.key, b'{"seq":%d,"stamp_ns":7}' % seq, 7)
        for bad in (b"", b"[]", b"{}", b'{"seq":1}', b'{"seq":-1,"stamp_ns":1}', b'{"seq":1,"stamp_ns":1,"x":NaN}'):
            session.add(MOCAP_FRAME.key, bad, 7)
        session.add(MOCAP_FRAME.key, b'{"seq":1,"stamp_ns":1,"x":"' + b"x" * 65_536 + b'"}', 7)
    verdict = read(file).verdict
    assert verdict.topics[GUIDANCE.key] == Count(received=6, missing=3, restarts=1, first_seq=5, last_seq=4)
    assert verdict.topics[MOCAP_FRAME.key] == Count(malformed=7)
    assert verdict.lost == 10


def test_a_put_on_a_wildcard_is_malformed_not_a_crash(tmp_path):
    class WildcardBus(MemoryBus):
        def subscribe(self, key, on_payload):
            super().subscribe(key, lambda _, payload: on_payload("guidance/*", payload))

    async def scene():
        bus = WildcardBus()
        node = Node("recorder", bus, VirtualClock())
        recording = service.record(node, bus, file=tmp_path / "a.mcap", params=PARAMS, metadata={}, attachments={})
        task = asyncio.create_task(recording)
        await asyncio.sleep(0.1)
        bus.put(GUIDANCE.key, b'{"seq":1,"stamp_ns":7}', Stance.BULK)
        await asyncio.sleep(0.1)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    run_virtual(scene())
    assert read(tmp_path / "a.mcap").verdict.topics[GUIDANCE.key] == Count(malformed=1)


def test_times_in_the_file_are_wall_clock_and_a_second_host_is_moved_onto_it(tmp_path):
    file = tmp_path / "a.mcap"
    far_ns = 900_000_000_000_000  # another host's monotonic clock
    with SessionWriter(file, TOPICS, epoch_ns=synthetic.EPOCH_NS, chunk_bytes=1000) as session:
        for seq in (1, 2, 3):
            session.add(GUIDANCE.key, b'{"seq":%d,"stamp_ns":%d}' % (seq, seq * 10**9), seq * 10**9 + 500)
            session.add(HANDLE_STATE.key, b'{"seq":%d,"stamp_ns":%d}' % (seq, far_ns + seq * 10**9), seq * 10**9 + 500)
    logs = read(file).logs
    assert logs[GUIDANCE.key].times_ns == [synthetic.EPOCH_NS + seq * 10**9 for seq in (1, 2, 3)]
    assert logs[HANDLE_STATE.key].times_ns == [synthetic.EPOCH_NS + seq * 10**9 + 500 for seq in (1, 2, 3)]


def test_an_ordinary_reader_finds_one_json_channel_for_each_topic(tmp_path, whole):
    (tmp_path / "a.mcap").write_bytes(whole)
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None
        assert {channel.topic for channel in summary.channels.values()} == {channel_name(key) for key in BY_KEY}
        assert {channel.message_encoding for channel in summary.channels.values()} == {"json"}
        assert {schema.encoding for schema in summary.schemas.values()} == {"jsonschema"}
        assert channel_name(REQUEST.key) == "/cmd/request"
        schema, _, message = next(iter(reader.iter_messages([channel_name(HANDLE_STATE.key)])))
        content = json.loads(message.data)
    assert schema is not None
    assert schema.name == "HandleState"
    assert message.sequence == content["seq"] == 1
    assert message.log_time == message.publish_time == content["stamp_ns"] + synthetic.EPOCH_NS - synthetic.MONOTONIC_NS


def test_tables_have_the_values_that_were_said(tmp_path, whole):
    (tmp_path / "a.mcap").write_bytes(whole)
    session = read(tmp_path / "a.mcap")
    messages, table = session.messages(HANDLE_STATE), session.table(HANDLE_STATE)
    assert table["position_m"].tolist() == [m.position_m.array().tolist() for m in messages]
    assert table["seq"].tolist() == [m.seq for m in messages]
    assert table["inputs.mocap/frame"].tolist() == [m.inputs.get("mocap/frame", 0) for m in messages]
    assert table["source"].tolist() == [m.source for m in messages]
    assert session.table(MOCAP_FRAME)["handle.position_m"].shape == (len(session.table(MOCAP_FRAME)["seq"]), 3)
    assert [interval.phase for interval in session.phases] == [phase for phase, _, _ in synthetic_world.PHASES]
    assert session.phases[-1].end_s == session.duration_s


def test_json_of_another_type_is_left_out_of_a_table(tmp_path):
    good = Heartbeat.model_construct(
        seq=1, stamp_ns=1, inputs={}, valid=True, invalid_reason="", service="tracker", pid=1, loop_rate_Hz=1.0,
        loop_lateness_p99_ms=0.0, missed_periods=0, longest_stall_ms=0.0, cpu_fraction=0.0, received={}, rejected={},
        status="",
    )  # fmt: skip
    topic = HEALTH["tracker"]
    with SessionWriter(tmp_path / "a.mcap", TOPICS, epoch_ns=synthetic.EPOCH_NS, chunk_bytes=1000) as session:
        session.add(topic.key, good.model_dump_json().encode(), 1)
        session.add(topic.key, b'{"seq":2,"stamp_ns":2}', 2)
    table = read(tmp_path / "a.mcap").table(topic)
    assert table["seq"].tolist() == [1]
    assert len(table["t_s"]) == 1


class Sized(bytes):
    """Bytes that a failing test shows by their length."""

    def __repr__(self):
        return f"<{len(self)} bytes>"


@settings(max_examples=40, deadline=None)
@given(cut=st.one_of(st.integers(0, 300), st.floats(0.0, 1.0, exclude_max=True)))
def test_a_recording_cut_off_anywhere_gives_back_its_whole_chunks(tmp_path_factory, whole, cut):
    at = cut if isinstance(cut, int) else int(cut * len(whole))
    file = tmp_path_factory.mktemp("cut") / "a.mcap"
    file.write_bytes(whole[:at])
    if at < 8:
        with pytest.raises(ValueError, match=r"not an MCAP file|is empty"):
            read(file)
        return
    session = read(file)
    assert session.verdict.lost == 0  # what is lost is the end, never something in between
    assert session.damage.startswith("cut off") or at > len(whole) - 9  # the closing magic says nothing
    for key, log in session.logs.items():
        assert log.payloads == _spoken()[key][: len(log.payloads)]


@cache
def _spoken():
    """Payloads by topic."""
    spoken: dict[str, list[bytes]] = {}
    for key, payload, _ in synthetic.samples(SHORT):
        spoken.setdefault(key, []).append(payload)
    return spoken


def test_the_loss_of_a_cut_is_no_more_than_what_was_not_flushed(tmp_path, said):
    file = tmp_path / "a.mcap"
    session = SessionWriter(file, TOPICS, epoch_ns=synthetic.EPOCH_NS, chunk_bytes=65_536)
    for key, payload, stamp_ns in said[:4000]:
        session.add(key, payload, stamp_ns)
    session.flush()
    for key, payload, stamp_ns in said[4000:4100]:
        session.add(key, payload, stamp_ns)
    copy = tmp_path / "killed.mcap"
    copy.write_bytes(file.read_bytes())  # what a killed process would have left
    session.close()
    killed = read(copy)
    assert "cut off" in killed.damage
    assert not killed.verdict.closed
    assert killed.verdict.received == 4000
    assert "epoch_minus_monotonic_ns" in killed.metadata["clew.clock"]


def test_a_damaged_chunk_is_left_out_and_said(tmp_path, whole):
    data = bytearray(whole)
    summary = make_reader(BytesIO(whole)).get_summary()
    assert summary
    chunk = summary.chunk_indexes[len(summary.chunk_indexes) // 2]
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0xFF
    (tmp_path / "a.mcap").write_bytes(data)
    session = read(tmp_path / "a.mcap")
    assert session.damage != ""
    assert len(session.table(SAFETY_STATE)["seq"]) > 100


def test_no_phase_without_a_word_from_the_supervisor(tmp_path):
    SessionWriter(tmp_path / "a.mcap", TOPICS, epoch_ns=0, chunk_bytes=1000).close()
    session = read(tmp_path / "a.mcap")
    assert session.phases == []
    assert session.duration_s == 0.0
    assert Phase.GUIDING not in session.phases
