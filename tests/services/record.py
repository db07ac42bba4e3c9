"""A flight on virtual time as the recorder would have left it."""

from pathlib import Path

from schemas.topics import TOPICS
from services.recorder.writer import SessionWriter
from services.rehearsal.chain import Flight
from tests.services.synthetic import EPOCH_NS


def record(file: Path, flight: Flight) -> Path:
    said = sorted(((m.stamp_ns, key, m) for key, heard in flight.said.items() for m in heard), key=lambda x: x[:2])
    config = flight.config.model_dump_json().encode()
    attachments = {"config.json": config}
    with SessionWriter(file, TOPICS, epoch_ns=EPOCH_NS, chunk_bytes=65_536, attachments=attachments) as session:
        for stamp_ns, key, message in said:
            session.add(key, message.model_dump_json().encode(), stamp_ns)
    return file
