"""Recordings of real flights, kept to be run again: one of the stand-in, one of real PX4, each on its own machine.

`python -m tests.golden_recordings [PROFILE...]` flies and keeps them anew (px4-sitl needs PX4_BIN); `make golden` does, after
a change of behaviour that is meant. Kept are the first KEPT_S of a walk along a short path, without the simulated truth and
the heartbeats, which no service reads: from take-off until the person has arrived.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from pydantic_core import from_json

from schemas.topics import BY_KEY, TRUTH
from services.recorder.writer import channel_name
from services.rehearsal.quick import SHORT_PATH

FOLDER = Path(__file__).parent / "golden"
PROFILES = ("demo", "px4-sitl")
KEPT_S = 30.0
LEFT_OUT = {channel_name(key) for key in BY_KEY if key == TRUTH.key or key.startswith("health/")}


def file_of(profile: str) -> Path:
    return FOLDER / f"{profile}.mcap.zst"


def unpacked(profile: str, folder: Path) -> Path:
    """The recording as a file that everything here can read."""
    file = folder / f"{profile}.mcap"
    file.write_bytes(zstandard.ZstdDecompressor().decompress(file_of(profile).read_bytes(), max_output_size=2**28))
    return file


def keep(recording: Path, kept: Path) -> None:
    """Write what is worth keeping of `recording`, small."""
    with tempfile.TemporaryDirectory() as name:
        plain = Path(name, "plain.mcap")
        with recording.open("rb") as source, plain.open("wb") as target:
            _copy(source, target)
        kept.write_bytes(zstandard.ZstdCompressor(level=19).compress(plain.read_bytes()))


def _copy(source, target) -> None:
    reader, writer = make_reader(source), Writer(target, chunk_size=2**28, compression=CompressionType.NONE)
    writer.start(library="clew")
    for record in reader.iter_metadata():
        writer.add_metadata(record.name, dict(record.metadata))
    for attachment in reader.iter_attachments():
        writer.add_attachment(
            attachment.create_time, attachment.log_time, attachment.name, attachment.media_type, attachment.data
        )
    ids, first_ns = dict[int, int](), None
    for schema, channel, message in reader.iter_messages():
        said_ns = from_json(message.data)["said_ns"]  # not its stamp: what it was made of was said before
        first_ns = said_ns if first_ns is None else first_ns
        if channel.topic in LEFT_OUT or (said_ns - first_ns) * 1e-9 > KEPT_S:
            continue
        if channel.id not in ids:
            assert schema
            of = writer.register_schema(schema.name, schema.encoding, schema.data)
            ids[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, of, dict(channel.metadata)
            )
        writer.add_message(ids[channel.id], message.log_time, message.data, message.publish_time, message.sequence)
    writer.finish()


def fly(profile: str, out: Path) -> Path:
    """One flight along the short path in real time, as a user flies it. Returns its recording."""
    path = out / "short.toml"
    force = ", ".join(f"{key} = {value}" for key, value in SHORT_PATH["force"].items())
    path.write_text(f'name = "short"\nwaypoints_m = {SHORT_PATH["waypoints_m"]}\nforce = {{{force}}}\n')
    command = [sys.executable, "-P", "-m", "services.console.cli", "demo", "--no-live", "--profile", profile]
    subprocess.run([*command, "--path", str(path), "--out", str(out)], check=True)
    return out / "latest/session.mcap"


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for profile in sys.argv[1:] or PROFILES:
        with tempfile.TemporaryDirectory() as out:
            keep(fly(profile, Path(out)), file_of(profile))


if __name__ == "__main__":
    main()
