"""Recorder: keeps every logged topic as it was said.

listens   every topic that the table marks logged, as bytes
ticks     25 Hz, to write what has arrived since (so an arrival is known to 40 ms); a flush after each
          `flush_period_s` bounds what a kill can lose
says      in its heartbeat, how much it holds and what it missed
"""

import asyncio
import platform
import time
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from schemas.topics import TOPICS
from services.config import Config
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
    metadata = {"profile": config.system.name, "seed": str(config.system.seed), "host": platform.node()}
    metadata |= {name: version(name) for name in ("clew-hri", "eclipse-zenoh", "mavsdk", "numpy", "pydantic")}
    await record(
        node,
        node.bus,
        file=Path(config.session_dir, "session.mcap"),
        params=config.recorder,
        metadata=metadata,
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

    Raises FileExistsError rather than overwrite a recording, and OSError when the disk is full.
    """
    mailboxes = {topic.key: bus.mailbox(topic.key) for topic in LOGGED}
    epoch_ns = time.time_ns() - node.clock.now_ns()
    with SessionWriter(
        file,
        LOGGED,
        epoch_ns=epoch_ns,
        chunk_bytes=params.chunk_bytes,
        metadata=metadata,
        attachments=attachments,
        hosts=node.hosts,
    ) as session:
        try:
            await _write_on(node, session, mailboxes, max(1, round(params.flush_period_s * RATE_HZ)))
        finally:
            try:
                await asyncio.sleep(LINGER_S)
            finally:
                _write(session, mailboxes, node.clock.now_ns())


async def _write_on(node: Node, session: SessionWriter, mailboxes: Mailboxes, ticks_per_flush: int) -> None:
    async for tick in node.ticks(RATE_HZ):
        _write(session, mailboxes, node.clock.now_ns())
        if tick.n % ticks_per_flush == 0:
            session.flush()
            node.status = str(session.verdict)


def _write(session: SessionWriter, mailboxes: Mailboxes, now_ns: int) -> None:
    """A put on a wildcard is legal, and a message of no topic."""
    for topic_key, take in mailboxes.items():
        for key, payload in take():
            session.add(topic_key, payload if key == topic_key else b"", now_ns)
