"""Looking at a running system from outside, as a ROS user expects: topics, echo, hz, status."""

import asyncio
import os
import sys
import time
from collections import Counter
from collections.abc import Awaitable, Callable

from rich.table import Table

from schemas.health import Heartbeat
from schemas.safety import SafetyState
from schemas.topics import BY_KEY, HEALTH, SAFETY_STATE, TOPICS
from services.config import ConfigError, load, told_in
from services.console.replay import replay_bus_config
from services.console.start import clock_of, observer_bus, services_of
from services.console.terminal import console
from services.runtime.clock import MonotonicClock
from services.runtime.node import Node
from services.runtime.zenoh_bus import ZenohBus, open_bus

LISTEN_S = 1.2


def topics() -> None:
    """Print the table of schemas/topics.py."""
    table = Table("topic", "type", "rate Hz", "radio", "from", "to", "stance", "recorded", "about")
    for t in TOPICS:
        rate = f"{t.rate_Hz:g}" if t.rate_Hz else "-"
        radio = f"{t.radio_Hz:g} Hz" if t.radio_Hz else "packed" if t.packed else ""
        to, logged = ", ".join(t.subscribers), "yes" if t.logged else "no"
        table.add_row(t.key, t.type.__name__, rate, radio, t.publisher, to, t.stance.name, logged, t.about)
    console().print(table)


def echo(topic: str, profile: str, count: int, *, replay: bool = False) -> int:
    """Print messages until Ctrl-C, or `count` of them."""
    if topic not in BY_KEY:
        return _unknown(topic)

    async def follow(node: Node, _: ZenohBus) -> int:
        seen = 0
        async for message in node.stream(BY_KEY[topic]):
            print(message.model_dump_json(), flush=True)  # noqa: T201
            seen += 1
            if seen == count:
                break
        return 0

    return with_node(profile, follow, replay=replay)


def hz(keys: list[str], profile: str, seconds: float, *, replay: bool = False) -> int:
    """Count arrivals for `seconds` and print them beside the table's rates."""
    for key in keys:
        if key not in BY_KEY:
            return _unknown(key)

    async def measure(node: Node, _: ZenohBus) -> int:
        chosen = [BY_KEY[key] for key in keys] or list(TOPICS)
        for topic in chosen:
            node.latest(topic)
        await asyncio.sleep(0.3)  # to be connected
        before, began = Counter(node.received), time.monotonic()
        while time.monotonic() - began < seconds:
            await asyncio.sleep(min(0.5, seconds))
            sum(node.received.values())  # empties the mailboxes, which hold a few seconds
        took, arrived = time.monotonic() - began, Counter(node.received) - before
        table = Table("topic", "Hz", "table's Hz", "publisher")
        for topic in chosen:
            table.add_row(topic.key, f"{arrived[topic.key] / took:.1f}", f"{topic.rate_Hz:g}", topic.publisher)
        console().print(table)
        return 0

    return with_node(profile, measure, replay=replay)


def status(profile: str) -> int:
    """One heartbeat of each service of the system, and the supervisor's word; exit code 1 where a service is missing."""

    try:
        expected = services_of(load(profile))
    except ConfigError as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2

    async def listen(node: Node, bus: ZenohBus) -> int:
        hearts = {name: node.latest(HEALTH[name]) for name in expected}
        safety = node.latest(SAFETY_STATE)
        await asyncio.sleep(LISTEN_S)
        alive = bus.alive()
        table = Table("service", "present", "loop Hz", "late p99 ms", "missed", "cpu %", "rejected", "status")
        for name, heart in hearts.items():
            table.add_row(name, "yes" if name in alive else "NO", *_health(heart.value))
        screen = console()
        screen.print(table)
        screen.print(_verdict(safety.value))
        return 0 if set(hearts) <= alive else 1

    return with_node(profile, listen)


def _health(beat: Heartbeat | None) -> tuple[str, ...]:
    if beat is None:
        return ("silent", "", "", "", "", "")
    return (
        f"{beat.loop_rate_Hz:.0f}",
        f"{beat.loop_lateness_p99_ms:.1f}",
        str(beat.missed_periods),
        f"{100 * beat.cpu_fraction:.0f}",
        str(sum(beat.rejected.values())),
        beat.status,
    )


def _verdict(state: SafetyState | None) -> str:
    if state is None:
        return "supervisor: silent"
    why = "; ".join(state.reasons) or "nothing limits the system"
    return f"phase {state.phase}, level {state.level.name.lower()}, permit {state.permit}: {why}"


def with_node(profile: str, use: Callable[[Node, ZenohBus], Awaitable[int]], *, replay: bool = False) -> int:
    """Run `use` with an observer on the profile's bus, or on that of a replay."""
    try:
        config = load(profile)
        with told_in(profile):
            buses = replay_bus_config() if replay else observer_bus(config)
    except ConfigError as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2
    name = f"look-{os.getpid()}"

    async def main() -> int:
        with open_bus(buses, name) as bus:
            clock = MonotonicClock() if replay else clock_of(config, bus)
            node = Node(name, bus, clock, observer=True, placement=buses.placement)
            return await use(node, bus)

    try:
        return asyncio.run(main())
    except KeyboardInterrupt:
        return 0


def _unknown(topic: str) -> int:
    print(f"no topic {topic!r}; clew topics lists them", file=sys.stderr)  # noqa: T201
    return 2
