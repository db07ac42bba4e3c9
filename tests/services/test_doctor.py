"""Whatever the recorder, `clew recover` and `clew view` write passes the format's own checker."""

import shutil
import subprocess

import pytest
from mcap.reader import make_reader

from schemas.topics import GUIDANCE, TOPICS
from services.recorder.reading import Session
from services.recorder.recording import Recording
from services.recorder.recovery import recover
from services.recorder.writer import Recorder, SessionWriter
from services.viewer.view import prepare
from tests.golden_recordings import PROFILES, unpacked
from tests.services import synthetic, synthetic_world
from tests.services.doctor import examine

SHORT = synthetic_world.Scenario(guiding_s=2.0)
PROGRAM = shutil.which("mcap")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return synthetic.write(tmp_path_factory.mktemp("whole") / "session.mcap", SHORT)


def written(file, params=None, payloads=()):
    """A recording, in parts where `params` say so, of these payloads of one topic."""
    params = params or Recorder(flush_period_s=1, chunk_bytes=1000, rotate_bytes=10**9, rotate_s=1e9, free_min_bytes=0)
    recording = Recording(
        file, TOPICS, params, lambda part, verdict, n: SessionWriter(part, TOPICS, epoch_ns=0, chunk_bytes=1000), 0
    )
    for n, payload in enumerate(payloads):
        recording.add(GUIDANCE.key, payload, n)
        recording.flush(n)
    recording.close()
    return file


def damaged(file, whole, which):
    """A copy in which one chunk is spoilt."""
    data = bytearray(whole.read_bytes())
    with whole.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary
    chunk = summary.chunk_indexes[which]
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0xFF
    file.write_bytes(data)
    return file


def cut(file, whole, share):
    data = whole.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    return file


def recovered(file):
    out = file.with_name("recovered.mcap")
    recover(Session(file), out)
    return out


MADE = {
    "finished": lambda folder, whole: whole,
    "without a message": lambda folder, whole: written(folder / "a.mcap"),
    "recovered from a cut": lambda folder, whole: recovered(cut(folder / "a.mcap", whole, 0.5)),
    "recovered from a cut before the first message": lambda folder, whole: recovered(cut(folder / "a.mcap", whole, 2e-3)),
    "recovered from a damaged first chunk": lambda folder, whole: recovered(damaged(folder / "a.mcap", whole, 0)),
    "recovered from a damaged chunk": lambda folder, whole: recovered(damaged(folder / "a.mcap", whole, 5)),
    "with pictures": lambda folder, whole: prepare(Session(whole), folder)["session.mcap"],
    **{f"flown, {name}": lambda folder, whole, name=name: unpacked(name, folder) for name in PROFILES},
}  # fmt: skip


@pytest.mark.parametrize("kind", MADE)
def test_what_is_written_passes_the_doctors_rules(tmp_path, whole, kind):
    assert examine(MADE[kind](tmp_path, whole).read_bytes()) == []


def test_every_part_of_a_rotated_recording_passes_them_even_one_without_a_message(tmp_path):
    params = Recorder(flush_period_s=1, chunk_bytes=1000, rotate_bytes=1, rotate_s=1e9, free_min_bytes=0)
    written(tmp_path / "a.mcap", params, [b'{"seq":%d,"stamp_ns":%d}' % (n, n) for n in (1, 2, 3)])
    parts = sorted(tmp_path.iterdir())
    assert len(parts) == 4
    assert [examine(part.read_bytes()) for part in parts] == [[]] * 4


@pytest.mark.parametrize(
    ("spoil", "rule"),
    [
        (lambda folder, whole: cut(folder / "b.mcap", whole, 0.5), "frame"),
        (lambda folder, whole: damaged(folder / "b.mcap", whole, 0), "chunk"),
    ],
)
def test_the_rules_find_what_is_broken(tmp_path, whole, spoil, rule):
    assert any(finding.startswith(rule) for finding in examine(spoil(tmp_path, whole).read_bytes()))


@pytest.mark.skipif(PROGRAM is None, reason="the program `mcap` is not installed: only its rules were checked")
def test_the_program_itself_finds_no_error(tmp_path, whole):
    """It warns of messages that are written after later ones: times are those of their content, not of arrival."""
    for kind, make in MADE.items():
        folder = tmp_path / kind
        folder.mkdir()
        done = subprocess.run([str(PROGRAM), "doctor", make(folder, whole)], check=False, capture_output=True)
        assert done.returncode == 0, (kind, done.stdout[-1000:])
