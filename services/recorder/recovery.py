"""What can be saved of a recording that was cut off or damaged, as a file that every reader opens."""

from pathlib import Path

from mcap.writer import Writer

from services.recorder.reading import Session


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
        for name, metadata in session.metadata.items():
            if name != "clew.verdict":
                writer.add_metadata(name, dict(metadata))
        for name, data in session.attachments.items():
            writer.add_attachment(0, session.start_ns, name, "text/plain", data)
        for part in session.parts:
            channels: dict[int, int] = {}
            for old, channel in part.channels.items():
                schema = part.schemas.get(channel.schema_id)
                known = writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
                channels[old] = writer.register_channel(
                    channel.topic, channel.message_encoding, known, channel.metadata
                )
            for message in part.messages():
                writer.add_message(
                    channels[message.channel], message.log_ns, message.payload, message.log_ns, message.sequence
                )
                kept += 1
        writer.add_metadata("clew.verdict", {"json": verdict.to_json()})
        writer.finish()
    return kept
