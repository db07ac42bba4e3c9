"""The bus between processes: Zenoh peers on unix sockets. This file and no other knows Zenoh."""

# Zenoh's stubs leave some return types open.
# pyright: reportUnknownMemberType=false

import asyncio
import json
import os
import time
from collections import Counter, deque
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager, nullcontext
from itertools import cycle
from typing import Any

import zenoh
from zenoh import CongestionControl, Encoding, Priority, Reliability, Sample, SampleKind
from zenoh.handlers import RingChannel

from schemas.topics import BY_KEY, Stance
from services.runtime.bus import DEPTH, Mailbox, MAX_PAYLOAD_bytes, OnPayload
from services.runtime.bus_config import BusConfig, claim
from services.runtime.packing import packer, unpacker
from services.runtime.zenoh_log import read_along

LEASE_ms = 500
QUEUE = 16
"""Batches that wait for a busy link before DROP drops; Zenoh's own 2 lost samples on a loaded machine."""

RETRY_ms = 100
RUNTIME = "(rx: (worker_threads: 1), tx: (handover: rx), net: (handover: rx), acc: (handover: rx), app: (handover: rx))"
"""One thread of Zenoh's own for each session instead of six: on two cores their hand-overs cost more than their work.
Not over a radio: there a declaration waits for a link that is dead, and with one thread everything waits with it, for 3 s."""

# Nothing blocks: a blocked put on a dead link stalls local delivery too. Nothing is `express`: each such message takes a
# batch of its own, the queue holds QUEUE of them, and a stall of 50 ms already cost samples; it saved 0.05 ms a hop.
_PRIORITIES: dict[Stance, tuple[Priority, ...]] = {
    Stance.TWICE: (Priority.REAL_TIME, Priority.INTERACTIVE_HIGH),
    Stance.STREAM: (Priority.INTERACTIVE_LOW,),
    Stance.STATE: (Priority.DATA_HIGH,),
    Stance.COMMAND: (Priority.DATA_HIGH,),
    Stance.BULK: (Priority.DATA_LOW,),
}
"""By them the radio splits its links (gateway/session.py)."""
_MAY_BE_LOST = (Stance.STREAM, Stance.TWICE)
"""The radio does not send them again: what follows would have to wait for it."""


class ZenohBus:
    """One session. Made by `open_bus`; `subscribe` and `watch` want a running loop, into which they deliver."""

    def __init__(self, session: zenoh.Session, config: BusConfig) -> None:
        self.log = config.log
        self._session = session
        self._prefix = config.prefix
        self._outlets: dict[str, Callable[[bytes], None]] = {}
        self._over_a_radio = bool(config.placement.elsewhere)
        self._relays: list[_Relay] = []

    @property
    def dropped(self) -> int:
        """Samples lost between Zenoh and a loop that was stuck."""
        return sum(relay.dropped for relay in self._relays)

    def close(self) -> None:
        """When the session is closed."""
        for relay in self._relays:
            relay.close()

    def put(self, key: str, payload: bytes, stance: Stance) -> None:
        """Send over publishers that are declared on first use."""
        if key not in self._outlets:
            self._outlets[key] = self._outlet(key, stance)
        self._outlets[key](payload)

    def subscribe(self, key: str, on_payload: OnPayload) -> None:
        """Deliver the samples of `key` into the running loop."""
        unpack = self._unpacker(key)

        def deliver(full_key: str, sample: Sample) -> None:
            for payload in unpack(_payload(sample)):
                on_payload(full_key, payload)

        relay = _Relay(asyncio.get_running_loop(), deliver)
        self._relays.append(relay)
        self._session.declare_subscriber(self._prefix + key, self._into(relay))

    def mailbox(self, key: str) -> Mailbox:
        """As Bus.mailbox: a ring in Zenoh's own memory, so that an arrival costs Python nothing."""
        subscriber = self._session.declare_subscriber(self._prefix + key, RingChannel(DEPTH))
        strip, unpack = len(self._prefix), self._unpacker(key)

        def take() -> list[tuple[str, bytes]]:
            taken: list[tuple[str, bytes]] = []
            while sample := subscriber.try_recv():
                full_key = str(sample.key_expr)[strip:]
                taken.extend((full_key, payload) for payload in unpack(_payload(sample)))
            return taken

        return take

    def watch(self, on_change: Callable[[str, bool], None]) -> None:
        """Call `on_change(name, alive)` in the running loop for each bus name that is there, comes or goes."""
        loop = asyncio.get_running_loop()
        relay = _Relay(loop, lambda name, sample: on_change(name, sample.kind == SampleKind.PUT))
        self._relays.append(relay)
        token = f"{self._prefix}@alive/"
        handler = self._into(relay, token)
        self._session.liveliness().declare_subscriber(f"{token}*", handler, history=True)

    def alive(self, settle_s: float = 0.3) -> set[str]:
        """The names that hold a token now. Presence is not health. For tools: blocks while a new session's links build."""
        time.sleep(settle_s)
        token = f"{self._prefix}@alive/"
        replies = self._session.liveliness().get(f"{token}*", timeout=1.0)
        return {str(reply.ok.key_expr).removeprefix(token) for reply in replies if reply.ok}

    def answer(self, key: str, reply: Callable[[], bytes]) -> None:
        """Answer each question on `key` at once, in Zenoh's thread: `reply` must not wait."""
        full = self._prefix + key

        def told(query: zenoh.Query) -> None:
            query.reply(full, reply())

        self._session.declare_queryable(full, told)

    def ask(self, key: str, on_reply: Callable[[bytes, int], None], timeout_s: float) -> None:
        """Ask; `on_reply` gets the answer and when it arrived (monotonic, ns), in the running loop."""
        loop = asyncio.get_running_loop()

        def arrived(reply: zenoh.Reply) -> None:
            now_ns = time.monotonic_ns()
            if reply.ok and not loop.is_closed():
                loop.call_soon_threadsafe(on_reply, reply.ok.payload.to_bytes(), now_ns)

        self._session.get(
            self._prefix + key,
            arrived,
            timeout=timeout_s,
            priority=Priority.REAL_TIME,
            congestion_control=CongestionControl.DROP,
        )

    def ask_now(self, key: str, timeout_s: float) -> tuple[bytes, int] | None:
        """As `ask`, for tools: blocks; None where nobody answers."""
        for reply in self._session.get(self._prefix + key, timeout=timeout_s, priority=Priority.REAL_TIME):
            if reply.ok:
                return reply.ok.payload.to_bytes(), time.monotonic_ns()
        return None

    def remotes(self) -> dict[str, tuple[str, int]]:
        """By session, the certificate's name of each that is connected over the radio, and by how many links."""
        # Zenoh has one that is reliable as well as not in its list twice.
        links = {(str(each.zid), str(each.dst), each.auth_identifier) for each in self._session.info.links()}
        named = [(zid, name) for zid, _, name in links if name]
        return {zid: (name, count) for (zid, name), count in Counter(named).items()}

    def _outlet(self, key: str, stance: Stance) -> Callable[[bytes], None]:
        """One topic's way out. Over a radio the packets of guidance take turns on two links: loss keeps each one narrow."""
        over = self._packs(key)
        pack = packer(BY_KEY[key]) if over else bytes
        turns = cycle([self._declare(key, stance, each) for each in _PRIORITIES[stance][: None if over else 1]])

        def put(payload: bytes) -> None:
            next(turns).put(pack(payload))

        return put

    def _unpacker(self, key: str) -> Callable[[bytes], list[bytes]]:
        return unpacker(BY_KEY[key]) if self._packs(key) else lambda payload: [payload]

    def _packs(self, key: str) -> bool:
        return self._over_a_radio and key in BY_KEY and BY_KEY[key].packed

    def _declare(self, key: str, stance: Stance, priority: Priority) -> zenoh.Publisher:
        return self._session.declare_publisher(
            self._prefix + key,
            encoding=Encoding.APPLICATION_JSON.with_schema(BY_KEY[key].type.__name__),
            congestion_control=CongestionControl.DROP,
            priority=priority,
            reliability=Reliability.BEST_EFFORT if stance in _MAY_BE_LOST else Reliability.RELIABLE,
        )

    def _into(self, relay: "_Relay", prefix: str | None = None) -> Callable[[Sample], None]:
        strip = len(prefix or self._prefix)
        return lambda sample: relay.post(str(sample.key_expr)[strip:], sample)


class _Relay:
    """From Zenoh's thread into the loop: bounded, and with at most one wake-up under way.

    An eventfd wakes the loop sooner than call_soon_threadsafe, which makes a handle and writes to a socket.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, deliver: Callable[[str, Sample], None]) -> None:
        self.dropped = 0
        self._loop = loop
        self._fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._deliver = deliver
        self._waiting: deque[tuple[str, Sample]] = deque(maxlen=DEPTH)
        self._woken = False
        loop.add_reader(self._fd, self._empty)

    def post(self, key: str, sample: Sample) -> None:
        """In Zenoh's thread: must never wait."""
        self.dropped += len(self._waiting) == DEPTH
        self._waiting.append((key, sample))
        if not self._woken:
            self._woken = True
            os.eventfd_write(self._fd, 1)

    def close(self) -> None:
        """After the session. What was on its way in Zenoh's thread may still be posted: it wakes nobody."""
        self._woken = True
        if not self._loop.is_closed():
            self._loop.remove_reader(self._fd)
        os.close(self._fd)

    def _empty(self) -> None:
        os.eventfd_read(self._fd)
        self._woken = False  # first: what is posted from here on wakes the loop again
        for _ in range(len(self._waiting)):
            self._deliver(*self._waiting.popleft())


@contextmanager
def open_bus(config: BusConfig, name: str) -> Generator[ZenohBus]:
    """A session as service `name`, or as an observer under any other name. The `with` block is what lets a process end.

    Services may start in any order: sockets that are not there yet are tried again.

    Raises:
        AlreadyRunning: a living process holds the service's name.
        ValueError: a socket's path is too long.
    """
    if not config.settings:
        os.environ.setdefault("ZENOH_RUNTIME", RUNTIME)
    is_service = name in config.services
    with ExitStack() as stack:
        if config.log:
            stack.enter_context(read_along(config.log))
            zenoh.init_log_from_env_or(config.log.levels)
        stack.enter_context(claim(config, name) if is_service else nullcontext())
        closing = stack.enter_context(ExitStack())  # what must outlive the session
        session = stack.enter_context(zenoh.open(session_config(config, name)))
        stack.enter_context(session.liveliness().declare_token(f"{config.prefix}@alive/{name}"))
        bus = ZenohBus(session, config)
        closing.callback(bus.close)
        yield bus


def session_config(config: BusConfig, name: str) -> zenoh.Config:
    """How a peer of this system is set up: all links explicit, nothing scouted, a dead one noticed within 0.5 s."""
    listen = [_endpoint(config, name)] if name in config.services else []
    connect = [_endpoint(config, other) for other in config.services if other != name]
    values: dict[str, Any] = {
        "mode": "peer",
        "listen/endpoints": [*listen, *config.listen],
        "connect/endpoints": [*connect, *config.endpoints],
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": RETRY_ms, "period_max_ms": RETRY_ms, "period_increase_factor": 1},
        "open/return_conditions": {"connect_scouted": False, "declares": False},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": LEASE_ms,
        "transport/link/tx/queue/size/real_time": QUEUE,
        "transport/link/tx/queue/size/interactive_high": QUEUE,
        "transport/link/tx/queue/size/interactive_low": QUEUE,
        "transport/link/tx/queue/size/data_high": QUEUE,
        "transport/shared_memory/enabled": False,
    } | config.settings
    made = zenoh.Config()
    for key, value in values.items():
        made.insert_json5(key, json.dumps(value))
    return made


def _endpoint(config: BusConfig, name: str) -> str:
    return f"unixsock-stream/{config.socket(name)}"


def _payload(sample: Sample) -> bytes:
    acceptable = sample.kind == SampleKind.PUT and len(sample.payload) <= MAX_PAYLOAD_bytes
    return sample.payload.to_bytes() if acceptable else b""
