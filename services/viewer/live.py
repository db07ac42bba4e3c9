"""`clew live`: the running system to Foxglove or Lichtblick, as it happens. It listens and says nothing."""

import asyncio
import os
import time

import foxglove

from schemas.topics import TOPICS
from services.config import ConfigError, load
from services.console.replay import replay_bus_config
from services.console.start import bus_config
from services.runtime.zenoh_bus import ZenohBus, open_bus
from services.session_files import complain
from services.viewer.pictures import SCENE_HZ, Pictures


def command(profile: str, host: str, port: int, *, replay: bool) -> int:
    """Serve until Ctrl-C. Returns 2 for bad configuration, 1 where the port is taken."""
    try:
        config = load(profile)
    except ConfigError as error:
        return complain(error)
    context = foxglove.Context()
    pictures = Pictures(context, config.guided_path)
    try:
        server = foxglove.start_server(name=f"Clew: {config.system.name}", host=host, port=port, context=context)
    except RuntimeError as error:
        complain(OSError(f"port {port}: {error}"))
        return 1
    print(f"ws://{host}:{port} for Foxglove or Lichtblick (Foxglove WebSocket); Ctrl-C stops", flush=True)  # noqa: T201
    try:
        with open_bus(replay_bus_config() if replay else bus_config(config), f"live-{os.getpid()}") as bus:
            asyncio.run(follow(bus, pictures))
    except KeyboardInterrupt:
        return 0
    finally:
        server.stop()
    return 0


async def follow(bus: ZenohBus, pictures: Pictures) -> None:
    """Hand on what is said, for ever; what is not a message of its topic is left out by the viewer's own checks."""
    for topic in TOPICS:
        bus.subscribe(topic.key, lambda key, payload: _hand_on(pictures, key, payload))
    while True:
        await asyncio.sleep(1.0 / SCENE_HZ)
        pictures.tick(time.time_ns())  # when everybody has fallen silent, the picture empties


def _hand_on(pictures: Pictures, key: str, payload: bytes) -> None:
    """By the time of its arrival: several hosts have several clocks."""
    if payload.startswith(b"{"):
        pictures.take(key, payload, time.time_ns())
