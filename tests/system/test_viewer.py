"""What a viewer is given: every topic as it was said, a scene beside it, layouts that name what exists, and a server."""

import json
import shutil
import socket
import struct
import subprocess
import threading
import urllib.error
import urllib.request
from contextlib import contextmanager

import foxglove
import numpy as np
import pytest
from hypothesis import assume, given
from mcap.reader import make_reader

from schemas.topics import CABLE_FORCE, HANDLE_STATE, SAFETY_STATE, TOPICS
from services.recorder.reading import read
from services.recorder.schema import json_schema, unviewable
from services.recorder.writer import channel_name
from services.viewer import layout, scene, view
from services.viewer.pictures import FRESH_S, LOG, PLACE, SCENE, SCENE_HZ, SILENT, TRANSFORMS, Pictures
from tests.laws.strategies import vectors
from tests.services import synthetic
from tests.services.synthetic_world import Scenario
from tests.system.demo_profile import clew, write_profile
from tests.system.test_page import QUIET

SHORT = Scenario(guiding_s=2.0)


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    return read(synthetic.write(tmp_path_factory.mktemp("viewed") / "session.mcap", SHORT))


@pytest.fixture(scope="module")
def files(session, tmp_path_factory):
    return view.prepare(session, tmp_path_factory.mktemp("served"))


@pytest.fixture(scope="module")
def shown(files):
    """Messages by topic, and schemas by topic, as an ordinary reader finds them."""
    messages, schemas = {}, {}
    with files["session.mcap"].open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            messages.setdefault(channel.topic, []).append(message)
            schemas[channel.topic] = schema
    return messages, schemas


def test_every_topic_is_as_it_was_said(session, shown):
    messages, schemas = shown
    for key, log in session.logs.items():
        name = channel_name(key)
        assert [m.data for m in messages[name]] == log.payloads
        assert schemas[name].encoding == "jsonschema"
        assert list(unviewable(json.loads(schemas[name].data), name)) == []


def test_scene_transforms_and_log_are_foxgloves(session, shown):
    messages, schemas = shown
    for topic, kind in ((SCENE, "SceneUpdate"), (PLACE, "SceneUpdate"), (TRANSFORMS, "FrameTransforms"), (LOG, "Log")):
        assert (schemas[topic].name, schemas[topic].encoding) == (f"foxglove.{kind}", "protobuf")
    moving = [m for m in messages[SCENE] if b"cable" in m.data]
    assert len(moving) == pytest.approx(session.duration_s * SCENE_HZ, rel=0.1)
    late = moving[-20].data
    for name in (b"drone", b"handle", b"person", b"world"):
        assert name in late
    assert all(b"path" in m.data for m in messages[PLACE])
    assert not any(b"path" in m.data for m in messages[SCENE])  # after a jump in time a viewer has the last of each
    assert any(b"guiding" in m.data for m in messages[LOG])
    assert b"robot" in messages[TRANSFORMS][-1].data
    assert b"world" in messages[TRANSFORMS][0].data


def test_what_is_invalid_or_old_is_not_drawn(tmp_path):
    """A handle nobody sees, a force nobody trusts, a bridge that died: none of them may stand in the picture."""
    payloads = {}
    for key, payload, stamp_ns in synthetic.samples(SHORT):
        if stamp_ns < synthetic.MONOTONIC_NS + 5_000_000_000:
            payloads[key] = payload
    doubted = dict(payloads)
    for key in (HANDLE_STATE.key, CABLE_FORCE.key):
        doubted[key] = json.dumps(json.loads(payloads[key]) | {"valid": False}).encode()
    late_ns = round((FRESH_S + 0.1) * 1e9)
    assert _drawn(tmp_path / "seen.mcap", payloads) >= {b"drone", b"handle", b"cable", b"person"}
    assert _drawn(tmp_path / "doubted.mcap", doubted) == {b"drone", b"person"}
    assert _drawn(tmp_path / "dead.mcap", payloads, late_ns) == set()


def test_a_silent_supervisor_is_said_in_the_picture(tmp_path):
    payloads = {key: payload for key, payload, _ in synthetic.samples(SHORT) if key != SAFETY_STATE.key}
    assert SILENT.encode() in _drawn(tmp_path / "silent.mcap", payloads, words=(SILENT.encode(),))


def _drawn(file, payloads, later_ns=0, words=(b"drone", b"handle", b"cable", b"person")):
    """Which words are in the scene that is drawn so long after these messages."""
    context = foxglove.Context()
    with foxglove.open_mcap(file, context=context):
        pictures = Pictures(context, None)
        for key, payload in payloads.items():
            pictures.take(key, payload, 1)
        pictures.tick(100_000_000 + later_ns)
    with file.open("rb") as stream:
        last = [message.data for _, channel, message in make_reader(stream).iter_messages() if channel.topic == SCENE][
            -1
        ]
    return {word for word in words if word in last}


@given(vectors(3.0))
def test_an_arrow_points_along_its_force(v):
    assume(np.linalg.norm(v) > 1e-3)
    w, x, y, z = scene.along(v)
    axis = (w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y))  # R(q) e_x
    assert np.array(axis) == pytest.approx(v / np.linalg.norm(v), abs=2e-3)


def test_the_cable_is_grey_when_slack_and_redder_the_harder_it_pulls():
    assert scene.tension_color(0.0) == "#bbbbbb"
    reds = [int(scene.tension_color(pull)[1:3], 16) for pull in (0.1, 1.0, 2.0, 2.5, 9.0)]
    assert reds == sorted(reds)
    assert reds[-1] == reds[-2]


def test_layouts_name_topics_and_fields_that_exist():
    names = {channel_name(topic.key): topic for topic in TOPICS}
    for curves in layout.CURVES.values():
        for path in layout.paths(curves):
            topic, _, field = path.strip().partition(".")
            schema = json_schema(names[topic].type)
            for part in field.split("."):
                schema = schema["properties"][part]
    whole = json.loads(layout.lichtblick())
    assert set(_leaves(whole["layout"])) == set(whole["configById"])
    assert set(whole["configById"]["3D!scene"]["topics"]) == {SCENE, PLACE, TRANSFORMS}
    assert SCENE in layout.foxglove()
    assert json.loads(layout.foxglove())["content"]


def _leaves(tree):
    return [tree] if isinstance(tree, str) else [*_leaves(tree["first"]), *_leaves(tree["second"])]


@contextmanager
def served(files):
    server = view.serve(files, 0)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def got(address, **headers):
    with urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=5.0) as answer:
        return answer.status, answer.read(), answer.headers


def test_a_viewer_reads_the_file_in_parts(files):
    whole = files["session.mcap"].read_bytes()
    with served(files) as address:
        status, data, headers = got(f"{address}session.mcap?x=1")
        assert (status, data, headers["Access-Control-Allow-Origin"]) == (200, whole, "*")
        for asked, part in (("bytes=0-7", whole[:8]), ("bytes=-8", whole[-8:]), ("bytes=100-", whole[100:])):
            status, data, headers = got(f"{address}session.mcap", Range=asked)
            assert (status, data) == (206, part)
            assert headers["Content-Range"].endswith(f"/{len(whole)}")
        assert got(f"{address}session.mcap", Range="bytes=9999999999-")[0] == 200
        with pytest.raises(urllib.error.HTTPError, match="404"):
            got(f"{address}../etc/passwd")


def test_a_browser_opens_the_page_and_finds_the_viewers(files, tmp_path):
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium is installed")
    with served(files) as address:
        command = [browser, *QUIET, f"--user-data-dir={tmp_path}", "--dump-dom", address]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert 'data-ready="yes"' in ended.stdout
    assert "ds=remote-file&amp;ds.url=http%3A%2F%2F127.0.0.1" in ended.stdout
    assert "&amp;layoutUrl=http%3A%2F%2F127.0.0.1" in ended.stdout
    assert "CONSOLE" not in ended.stderr


def test_the_live_server_speaks_foxgloves_protocol(session, tmp_path):
    """A replay, looked at through the WebSocket: topics are offered, and the server is told apart by its name."""
    profile, port = write_profile(tmp_path), _free_tcp_port()
    process = clew(tmp_path, "live", "--port", str(port), "--replay", "--profile", str(profile))
    try:
        assert process.stdout
        assert f":{port}" in process.stdout.readline()
        texts = _texts(port, 2)
    finally:
        process.terminate()
        process.communicate()
    info, offer = sorted(texts, key=lambda text: text["op"] != "serverInfo")
    assert info["name"].startswith("Clew: ")
    assert {SCENE, PLACE, TRANSFORMS, LOG, *(channel_name(topic.key) for topic in TOPICS)} <= {
        channel["topic"] for channel in offer["channels"]
    }


def _free_tcp_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def _texts(port, count):
    """The first text messages of the server."""
    with socket.create_connection(("127.0.0.1", port), timeout=10.0) as wire:
        key = "dGhlIHNhbXBsZSBub25jZQ=="
        wire.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\n"
            "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
        )
        stream = wire.makefile("rb")
        assert b"101" in stream.readline()
        while stream.readline().strip():
            pass
        found = []
        while len(found) < count:
            first, length = stream.read(2)
            if length > 125:
                (length,) = struct.unpack(">H" if length == 126 else ">Q", stream.read(2 if length == 126 else 8))
            data = stream.read(length)
            if first & 15 == 1:
                found.append(json.loads(data))
        return found
