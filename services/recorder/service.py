"""Recorder: keeps every logged topic as it was said.

listens   every topic that the table marks logged, as bytes
ticks     25 Hz, to write what has arrived since (so an arrival is known to 40 ms); a flush after each
          `flush_period_s` bounds what a kill can lose
says      in its heartbeat, how much it holds and what it missed
"""

import asyncio
import time
from collections.abc import Mapping
from pathlib import Path

from schemas.topics import TOPICS
from services.config import Config
from services.recorder.origin import origin
from services.recorder.recording import Recording
from services.recorder.verdict import Verdict
from services.recorder.walk import CONFIG_ATTACHMENT
from services.recorder.writer import Recorder, SessionWriter
from services.runtime.bus import Bus, Mailbox
from services.runtime.node import Node

RATE_HZ = 25.0
LINGER_S = 0.1
LOGGED = tuple(topic for topic in TOPICS if topic.logged)

Mailboxes = Mapping[str, Mailbox]


async def run(node: Node, config: Config) -> None:
    """Record the session of `config` into its folder until cancelled."""
    await record(
        node,
        node.bus,
        file=Path(config.session_dir, "session.mcap"),
        params=config.recorder,
        metadata=origin(config),
        attachments={CONFIG_ATTACHMENT: config.model_dump_json(indent=1).encode()},
    )


async def record(
    node: Node,
    bus: Bus,
    *,
    file: Path,
    params: Recorder,
    metadata: Mapping[str, str],
    attachments: Mapping[str, bytes],
) -> None:
    """Record into `file` until cancelled; then listen on for LINGER_S, write the verdict and finish the file.

    Raises FileExistsError rather than overwrite a recording, and OSError where it cannot be begun. A disk that is full
    later ends the recording and is told in the heartbeat: nobody who flies may stop for it.
    """
    mailboxes = {topic.key: bus.mailbox(topic.key) for topic in LOGGED}
    epoch_ns = time.time_ns() - node.clock.now_ns()

    def open_part(part: Path, verdict: Verdict, n: int) -> SessionWriter:
        return SessionWriter(
            part,
            LOGGED,
            epoch_ns=epoch_ns,
            chunk_bytes=params.chunk_bytes,
            metadata={**metadata, "part": str(n)},
            attachments=attachments,
            verdict=verdict,
            hosts=node.hosts,
        )

    recording = Recording(file, LOGGED, params, open_part, node.clock.now_ns())
    try:
        await _write_on(node, recording, mailboxes, max(1, round(params.flush_period_s * RATE_HZ)))
    finally:
        try:
            await asyncio.sleep(LINGER_S)
        finally:
            _write(recording, mailboxes, node.clock.now_ns())
            recording.close()


async def _write_on(node: Node, recording: Recording, mailboxes: Mailboxes, ticks_per_flush: int) -> None:
    async for tick in node.ticks(RATE_HZ):
        _write(recording, mailboxes, node.clock.now_ns())
        if tick.n % ticks_per_flush == 0:
            recording.flush(node.clock.now_ns())
            node.status = str(recording)


def _write(recording: Recording, mailboxes: Mailboxes, now_ns: int) -> None:
    """A put on a wildcard is legal, and a message of no topic."""
    for topic_key, take in mailboxes.items():
        for key, payload in take():
            recording.add(topic_key, payload if key == topic_key else b"", now_ns)
