"""What can be saved of a recording that was cut off or damaged, as a file that every reader opens."""

from pathlib import Path

from mcap.writer import Writer

from services.recorder.channels import Channels
from services.recorder.reading import Session
from services.recorder.records import RecordFile


def recover(session: Session, out: Path) -> int:
    """Write every message that can be read, with metadata, attachments, an index and a verdict of its own; how many.

    Raises FileExistsError rather than overwrite a file.
    """
    verdict = session.count()
    verdict.stopped = f"recovered from {session.file.name}; {session.damage}"
    kept = 0
    with out.open("xb") as stream:
        writer = Writer(stream)
        writer.start(profile="", library="clew")
        taken = Channels(writer, stream)
        for name, metadata in session.metadata.items():
            if name != "clew.verdict":
                writer.add_metadata(name, dict(metadata))
        for name, data in session.attachments.items():
            writer.add_attachment(0, session.start_ns, name, "text/plain", data)
        numbers = [_numbers(part, taken) for part in session.parts]
        for part, number in zip(session.parts, numbers, strict=True):
            for message in part.messages():
                writer.add_message(
                    number[message.channel], message.log_ns, message.payload, message.log_ns, message.sequence
                )
                kept += 1
        writer.add_metadata("clew.verdict", {"json": verdict.to_json()})
        taken.finish(kept)
        writer.finish()
    return kept


def _numbers(part: RecordFile, taken: Channels) -> dict[int, int]:
    """What a part's channels are called in the new file."""
    return {old: taken.add(channel, part.schemas.get(channel.schema_id)) for old, channel in part.channels.items()}
