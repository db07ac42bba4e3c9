"""`clew link`: what the radio between the two hosts is like, as seen from this one."""

import asyncio
import json
import sys
from collections import Counter, defaultdict
from dataclasses import asdict, dataclass, field, replace

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table

from schemas.message import Message
from schemas.radio import RadioClock
from schemas.topics import HEALTH, RADIO_CLOCK, TOPICS, Topic
from services.console.look import with_node
from services.runtime.node import Node
from services.runtime.zenoh_bus import ZenohBus

WINDOW_s = 2.0
_DEPTH = 2048


@dataclass(frozen=True)
class Arrivals:
    """One topic of the other host within a window. Lost is counted by seq; thinned topics have gaps by design."""

    rate_Hz: float
    lost: int
    thinned: bool
    age_p50_ms: float | None
    age_max_ms: float | None


@dataclass(frozen=True)
class View:
    """The radio during one window; None for what is not known."""

    up: bool
    round_trip_ms: float | None = None
    clock_offset_s: float | None = None
    """Ground less drone."""
    clock_uncertainty_ms: float | None = None
    time_of_day_apart_ms: float | None = None
    connects: int | None = None
    unanswered: int | None = None
    refused: dict[str, int] = field(default_factory=dict[str, int])
    """By topic, what services refused: too old, out of order, malformed; by deed, key and name what the access rules did."""
    topics: dict[str, Arrivals] = field(default_factory=dict[str, Arrivals])


class Watch:
    """Reads everything that comes from the other host."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._far = {t.key: node.queue(t, _DEPTH) for t in TOPICS if node.hosts.crosses(t.publisher)}
        self._clock = node.latest(RADIO_CLOCK)
        self._health = [node.latest(topic) for topic in HEALTH.values()]
        self._last_seq: dict[str, int] = {}
        self._said: defaultdict[str, list[tuple[int, float]]] = defaultdict(list)

    def view(self, window_s: float) -> View:
        """What happened since the last call."""
        topics = {q.topic.key: a for q in self._far.values() if (a := self._arrivals(q.topic, window_s))}
        refused: Counter[str] = Counter()
        for beat in self._health:
            refused.update(beat.value.rejected if beat.value else {})
        return _with_clock(View(up=False, refused=dict(refused), topics=topics), self._clock.value)

    def _arrivals(self, topic: Topic[Message], window_s: float) -> Arrivals | None:
        said, self._said[topic.key] = self._said[topic.key], []
        if not said:
            return None
        seqs, ages_s = [seq for seq, _ in said], sorted(age_s for _, age_s in said)
        before, self._last_seq[topic.key] = self._last_seq.get(topic.key, seqs[0] - 1), seqs[-1]
        return Arrivals(
            rate_Hz=round(len(said) / window_s, 1),
            lost=0 if topic.radio_Hz else max(0, seqs[-1] - before - len(seqs)),
            thinned=bool(topic.radio_Hz),
            age_p50_ms=_ms(ages_s[len(ages_s) // 2]),
            age_max_ms=_ms(ages_s[-1]),
        )

    async def listen(self) -> None:
        """Look often, so that an age is known to a few milliseconds."""
        while True:
            for key, queue in self._far.items():
                for message in queue.drain():
                    self._said[key].append((message.seq, queue.age_s))
            await asyncio.sleep(0.002)


def _with_clock(view: View, clock: RadioClock | None) -> View:
    if clock is None:
        return view
    return replace(
        view,
        up=clock.up,
        round_trip_ms=round(clock.round_trip_s * 1e3, 2),
        clock_offset_s=clock.ground_minus_drone_ns * 1e-9 if clock.valid else None,
        clock_uncertainty_ms=round(clock.uncertainty_s * 1e3, 2) if clock.valid else None,
        time_of_day_apart_ms=round(clock.time_of_day_apart_s * 1e3, 1),
        connects=clock.connects,
        unanswered=clock.unanswered,
    )


def _ms(seconds: float) -> float | None:
    return round(seconds * 1e3, 1) if seconds < float("inf") else None


def render(view: View) -> RenderableType:
    """For a terminal."""
    radio, topics = Table("radio", "", show_header=False), Table("topic", "Hz", "lost", "age p50 ms", "age max ms")
    for name, value in asdict(view).items():
        if name != "topics":
            radio.add_row(name.replace("_", " "), _word(value))
    for key, a in sorted(view.topics.items()):
        topics.add_row(
            key, f"{a.rate_Hz:g}", "thinned" if a.thinned else str(a.lost), _word(a.age_p50_ms), _word(a.age_max_ms)
        )
    return Group(radio, topics)


def _word(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {count}" for key, count in value.items()) or "nothing"  # pyright: ignore[reportUnknownVariableType]
    return "–" if value is None else f"{value:.7g}" if isinstance(value, float) else str(value)


def link(profile: str, *, as_json: bool, seconds: float) -> int:
    """Show the radio until Ctrl-C on a terminal, once otherwise. Exit code 1 where it is down, 2 for bad input."""

    async def show(node: Node, _: ZenohBus) -> int:
        if not node.hosts.two:
            print(f"{profile}: is a system on one host: it has no radio", file=sys.stderr)  # noqa: T201
            return 2
        watch = Watch(node)
        listening = asyncio.create_task(watch.listen())
        console = Console()
        try:
            await asyncio.sleep(1.0)  # to be connected, and the clocks known
            watch.view(1.0)
            await asyncio.sleep(seconds)
            view = watch.view(seconds)
            if view.connects is None:
                print("no word of the drone's gateway: is clew up on both hosts?", file=sys.stderr)  # noqa: T201
            if as_json:
                print(json.dumps(asdict(view)))  # noqa: T201
            elif not console.is_terminal:
                Console(width=160).print(render(view))
            else:
                await _live(watch, view, console, seconds)
            return 0 if view.up else 1
        finally:
            listening.cancel()

    return with_node(profile, show)


async def _live(watch: Watch, view: View, console: Console, seconds: float) -> None:
    with Live(render(view), console=console, auto_refresh=False) as screen:
        while True:
            await asyncio.sleep(seconds)
            screen.update(render(watch.view(seconds)), refresh=True)
