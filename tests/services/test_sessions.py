"""Complete or not and why, what a cut leaves, and what is no recording at all: in words, and in exit codes."""

import asyncio
import json
import resource
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from schemas.topics import GUIDANCE, HANDLE_STATE, HEALTH, NOTE, TOPICS
from services.config import load
from services.console import sessions as commands
from services.recorder import Session, service
from services.recorder.inspection import inspect
from services.recorder.origin import origin
from services.recorder.reading import NotARecording, read
from services.recorder.schema import json_schema
from services.recorder.writer import SessionWriter
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node
from services.runtime.virtual import VirtualClock, run_virtual
from tests.services import synthetic
from tests.services.synthetic_world import Scenario

SMALL = replace(load("demo").recorder, chunk_bytes=1000)


def write(file, messages, **how):
    """A finished recording of (key, payload) pairs."""
    with SessionWriter(file, TOPICS, epoch_ns=synthetic.EPOCH_NS, chunk_bytes=1000, **how) as session:
        for n, (key, payload) in enumerate(messages, 1):
            session.add(key, payload, n * 1_000_000)
    return file


def guidance(seq, **inputs):
    return b'{"seq":%d,"stamp_ns":%d,"inputs":%s}' % (seq, seq * 10**6, json.dumps(inputs).encode())


def test_a_whole_flight_is_complete(flown, recorded, capsys):
    assert commands.check(flown[1]) == 0
    said = capsys.readouterr().out
    assert said.endswith("complete\n")
    assert "NOT" not in said
    assert recorded.metadata["clew.session"] == origin(flown[0].config) | {"part": "1"}
    assert inspect(recorded).remarks == []


@pytest.mark.parametrize(
    ("scenario", "why"),
    [
        (Scenario(guiding_s=2.0, dropped={GUIDANCE.key: {40, 41}}), "guidance/command: 2 missing, 0 malformed"),
        (Scenario(guiding_s=2.0, dropped={HANDLE_STATE.key: {1, 2}}), "handle/state: begins with message 3"),
    ],
)
def test_what_is_missing_is_named(tmp_path, scenario, why, capsys):
    assert commands.check(synthetic.write(tmp_path / "session.mcap", scenario)) == 1
    said = capsys.readouterr().out
    assert why in said
    assert "NOT complete" in said


def test_an_input_that_is_not_there_is_named(tmp_path, recorded):
    logs = recorded.logs_of([HANDLE_STATE.key, GUIDANCE.key])
    said = [(HANDLE_STATE.key, payload) for payload in logs[HANDLE_STATE.key].payloads[:100]]
    said += [(GUIDANCE.key, payload) for payload in logs[GUIDANCE.key].payloads[:400]]
    lacking = inspect(read(write(tmp_path / "a.mcap", said))).lacking
    assert any(text.startswith("guidance/command used") and "of handle/state" in text for text in lacking)


def test_a_cut_recording_is_recovered_and_opens_everywhere(tmp_path, flown, capsys):
    whole = flown[1].read_bytes()
    cut, out = tmp_path / "session.mcap", tmp_path / "session.recovered.mcap"
    cut.write_bytes(whole[: len(whole) // 2])
    assert commands.check(tmp_path) == 1
    assert "the recorder did not come to finish it" in capsys.readouterr().out
    assert commands.save(tmp_path, None) == 0
    assert str(out) in capsys.readouterr().out
    before, after = read(cut), read(out)
    assert after.damage == ""
    assert {key: log.payloads for key, log in after.logs.items()} == {
        key: log.payloads for key, log in before.logs.items()
    }
    assert after.attachments == before.attachments
    assert after.verdict.stopped.startswith("recovered from session.mcap; cut off")
    with out.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == before.verdict.received
    assert commands.save(out, None) == 0
    assert "is whole" in capsys.readouterr().out
    assert commands.save(tmp_path, None) == 2  # what was saved is not overwritten
    assert "exists" in capsys.readouterr().err


def ros_bag(file):
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="rosbag2")
        schema = writer.register_schema("std_msgs/String", "ros2msg", b"string data")
        channel = writer.register_channel("/chatter", "cdr", schema)
        writer.add_message(channel, 1, b"\x00", 1)
        writer.finish()


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "is empty"),
        (b"ULog\x01\x12\x35", "a PX4 log, not an MCAP file"),
        (b"SQLite format 3\x00", "a ROS 2 bag in SQLite, not an MCAP file"),
        (b"hello", "5 bytes that are not an MCAP file"),
        (ros_bag, "a recording of ros2 rosbag2, not of Clew: chatter"),
    ],
)
def test_what_is_no_recording_says_what_it_is(tmp_path, content, why, capsys):
    file = tmp_path / "session.mcap"
    if callable(content):
        content(file)
    else:
        file.write_bytes(content)
    for command in (commands.check, lambda given: commands.save(given, None)):
        assert command(file) == 2
        assert why in capsys.readouterr().err
    assert commands.check(tmp_path / "none") == 2
    assert commands.overview(tmp_path / "none") == 2
    assert commands.overview(tmp_path.parent) == 0


def test_a_newer_format_and_a_changed_schema_are_told(tmp_path, monkeypatch):
    """A field that was not there yet loads with its default; one that is no longer there is named."""
    monkeypatch.setattr("services.recorder.writer.schema_text", lambda kind: older(kind))
    file = write(tmp_path / "a.mcap", [(GUIDANCE.key, guidance(1))], metadata={"format": "9"})
    remarks = inspect(read(file)).remarks
    assert "written in format 9, newer than 2: what is new in it is not read" in remarks
    assert "guidance/command: recorded with legacy_m, which messages no longer have" in remarks
    assert "guidance/command: recorded without said_ns" in remarks
    assert "nobody was guided: it has no phase 2" in remarks


def older(kind):
    schema = json_schema(kind)
    schema["properties"] = {"legacy_m": {"type": "number"}} | schema["properties"]
    del schema["properties"]["said_ns"]
    return json.dumps(schema).encode()


def test_a_message_from_before_a_field_existed_still_makes_a_column(tmp_path, recorded):
    payload = recorded.logs_of([HANDLE_STATE.key])[HANDLE_STATE.key].payloads[10]
    old = json.loads(payload)
    del old["said_ns"]
    file = write(tmp_path / "a.mcap", [(HANDLE_STATE.key, json.dumps(old).encode())])
    assert Session(file).handle.said_ns.tolist() == [0]
    assert len(Session(file).handle.position_m) == 1


def record(file, params, said, *, seconds=2.0, then=lambda: None):
    """Let the recorder listen while `said(bus, n)` is called 100 times a second, `then` in the middle; its node."""

    async def scene():
        bus = MemoryBus()
        node = Node("recorder", bus, VirtualClock())
        recording = service.record(node, bus, file=file, params=params, metadata={}, attachments={})
        task = asyncio.create_task(recording)
        for n in range(1, round(100 * seconds) + 1):
            await asyncio.sleep(0.01)
            said(bus, n)
            if n == round(50 * seconds):
                then()
        await asyncio.sleep(0.3)
        assert not task.done()
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        return node

    return run_virtual(scene())


def guide(bus, n):
    bus.put(GUIDANCE.key, guidance(n), GUIDANCE.stance)


def test_a_rotated_recording_is_one_session(tmp_path):
    file = tmp_path / "session.mcap"
    record(file, replace(SMALL, rotate_s=0.5), guide)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "session.2.mcap", "session.3.mcap", "session.4.mcap", "session.mcap",
    ]  # fmt: skip
    session = read(file)
    assert [json.loads(payload)["seq"] for payload in session.logs[GUIDANCE.key].payloads] == list(range(1, 201))
    assert session.verdict.topics[GUIDANCE.key].received == 200
    assert session.verdict.lost == 0
    assert session.damage == ""
    record(tmp_path / "large" / "session.mcap", replace(SMALL, rotate_bytes=1), guide, seconds=0.5)
    assert len(list((tmp_path / "large").iterdir())) > 1


def test_a_full_disk_ends_the_recording_and_not_the_recorder(tmp_path):
    """The kernel refuses to let the file grow, which looks the same; what came before can be read."""
    file, (soft, hard) = tmp_path / "session.mcap", resource.getrlimit(resource.RLIMIT_FSIZE)

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (file.stat().st_size + 5000, hard))

    try:
        node = record(file, SMALL, guide, then=limit)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert node.status.startswith("STOPPED: the file cannot be written")
    session = read(file)
    assert session.damage.startswith("cut off")
    assert len(session.logs[GUIDANCE.key].payloads) > 80


def test_a_disk_that_is_nearly_full_ends_the_recording_in_good_order(tmp_path):
    node = record(tmp_path / "session.mcap", replace(SMALL, free_min_bytes=10**15), guide, seconds=1.0)
    assert "are free on the disk" in node.status
    session = read(tmp_path / "session.mcap")
    assert session.damage == ""
    assert "are free on the disk" in session.verdict.stopped
    assert commands.check(tmp_path) == 1


def test_notes_stand_in_the_recording(tmp_path):
    note = b'{"seq":1,"stamp_ns":9,"said_ns":9,"inputs":{},"valid":true,"invalid_reason":"","operator":"a","text":"hi"}'
    record(tmp_path / "session.mcap", SMALL, lambda bus, n: bus.put(NOTE.key, note, NOTE.stance) if n == 5 else None)
    assert [message.text for message in read(tmp_path / "session.mcap").messages(NOTE)] == ["hi"]
    assert commands.note(" ", "demo") == 2


def test_columns_are_attributes_and_join_on_time(recorded):
    """Against the messages themselves."""
    handle, setpoint = recorded.handle, recorded.setpoint
    assert handle.position_m.shape == (len(handle), 3)
    joined = handle.at(setpoint.t_s)
    for i in (0, 1000, len(setpoint) - 1):
        expected = [np.interp(setpoint.t_s[i], handle.t_s, handle.position_m[:, axis]) for axis in range(3)]
        assert joined.position_m[i] == pytest.approx(expected)
        last = np.searchsorted(handle.t_s, setpoint.t_s[i], side="right") - 1
        assert joined.seq[i] == handle.seq[max(last, 0)]
    assert recorded.mocap_frame.handle.position_m.shape[1] == 3
    assert set(recorded.mocap_frame.handle.at(setpoint.t_s[:5]).tracked) <= {True, False}
    assert recorded.health_tracker.status[0] == recorded.table(HEALTH["tracker"])["status"][0]
    assert "position_m" in dir(handle)
    assert "handle" in dir(recorded)
    with pytest.raises(AttributeError, match="vehicle is more than one topic: vehicle_imu, vehicle_state"):
        _ = recorded.vehicle
    with pytest.raises(AttributeError, match="mocap is more than one topic: mocap_frame, mocap_seen"):
        _ = recorded.mocap
    with pytest.raises(AttributeError, match=r"no topic is called hand: try .*handle"):
        _ = recorded.hand
    with pytest.raises(AttributeError, match="handle has no speed"):
        _ = handle.speed


def test_a_topic_is_read_alone(flown):
    session = Session(flown[1])
    assert session.handle.position_m.shape[1] == 3
    assert set(session.__dict__) & {"logs", "damage"} == set()
    with pytest.raises(ValueError, match="nothing was said"):
        session.operator.at(np.zeros(1))


def test_who_walks_and_how_is_in_the_metadata():
    config = load("demo").model_copy(update={"subject": "S07", "condition": "dark"})
    told = origin(config)
    assert (told["subject"], told["condition"], told["profile"], told["path"]) == ("S07", "dark", "demo", "paper")
    assert issubclass(NotARecording, ValueError)
