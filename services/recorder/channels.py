"""The channels of a file. They stand in its first chunk; of a file without a message they are records of their own.

The writer drops a chunk that has no message, and then its summary names channels that are nowhere else: a broken file.
"""

from dataclasses import replace
from typing import BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Schema
from mcap.writer import Writer


class Channels:
    """Registers channels with a writer, before any message; `stream` is what that writer writes to."""

    def __init__(self, writer: Writer, stream: BinaryIO) -> None:
        self._writer, self._stream = writer, stream
        self._number: dict[tuple[str, str, bytes], int] = {}
        self._records = RecordBuilder()

    def add(self, channel: Channel, schema: Schema | None) -> int:
        """The number in this file of a channel, whatever numbers it and its schema had; the same where it is known."""
        same = channel.topic, channel.message_encoding, schema.data if schema else b""
        if same not in self._number:
            self._number[same] = self._register(channel, schema)
        return self._number[same]

    def _register(self, channel: Channel, schema: Schema | None) -> int:
        n = self._writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
        if schema:
            replace(schema, id=n).write(self._records)
        number = self._writer.register_channel(channel.topic, channel.message_encoding, n, channel.metadata)
        replace(channel, id=number, schema_id=n).write(self._records)
        return number

    def finish(self, messages: int) -> None:
        """Call it before the writer's own; `messages` is how many it was given."""
        if not messages:
            self._stream.write(self._records.end())
