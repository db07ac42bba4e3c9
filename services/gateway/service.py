"""Owns the radio of one host: a Zenoh router between the services' unix sockets and the other host's gateway.

Forwarding is the router's own work (session.py, access.py). This loop tells what the radio is like: the drone's gateway
asks the ground's for its time twice a second and says how far the clocks are apart; both say who is connected.
"""

import json
import time
from collections import Counter
from collections.abc import Callable
from typing import Protocol, cast

from schemas.radio import RadioClock
from schemas.topics import RADIO_CLOCK
from services.config import Config
from services.gateway import offset
from services.gateway.access import CLOCK
from services.gateway.radio import Radio
from services.gateway.refusals import Refusals
from services.runtime.node import Node

RATE_HZ = 10.0
_RESTART_ns = 1_000_000_000  # more than any error: the other host was started anew
GROUND_CLOCK = f"{CLOCK}ground"


class RadioBus(Protocol):
    """What a gateway needs of its bus beyond topics."""

    @property
    def log(self) -> Refusals | None:
        """What Zenoh's log told."""
        ...

    def answer(self, key: str, reply: Callable[[], bytes]) -> None:
        """Answer each question on `key` at once, in the bus's own thread."""
        ...

    def ask(self, key: str, on_reply: Callable[[bytes, int], None], timeout_s: float) -> None:
        """Ask; `on_reply` gets the answer and when it arrived, monotonic ns, in the running loop."""
        ...

    def remotes(self) -> dict[str, tuple[str, int]]:
        """Names of the certificates that are connected now and how many links each has, by session."""
        ...


async def run(node: Node, config: Config) -> None:
    """Until cancelled."""
    if config.radio is None:
        raise ValueError("radio: is missing: a gateway is for a system on two hosts")
    bus = cast("RadioBus", node.bus)
    watch = Remotes(config.radio)
    compare = Comparison(node, bus, config.radio) if config.system.host == "drone" else None
    if compare is None:
        bus.answer(GROUND_CLOCK, lambda: _times(node))
    async for tick in node.ticks(RATE_HZ):
        node.status = "; ".join(filter(None, (watch.tell(bus.remotes()), str(bus.log or ""))))
        if bus.log:
            node.rejected |= Counter(dict(bus.log.denied))
        if compare:
            compare.turn(tick.n, watch.connects)


def _times(node: Node) -> bytes:
    return json.dumps([node.clock.now_ns(), time.time_ns()]).encode()


class Remotes:
    """Who is connected, by certificate, and how often each came."""

    def __init__(self, radio: Radio) -> None:
        self._known, self._links = set(radio.names), len(radio.ports)
        self._sessions = set[str]()
        self.connects = 0

    def tell(self, sessions: dict[str, tuple[str, int]]) -> str:
        """A line for the health: names that are in the profile, and strangers."""
        self.connects += len(sessions.keys() - self._sessions)
        self._sessions = set(sessions)
        names = sorted(name for name, _ in sessions.values())
        known = [name for name in names if name in self._known]
        strangers = [name for name in names if name not in self._known]
        hosts = [(name, links) for name, links in sessions.values() if name.startswith(("drone:", "ground:"))]
        twice = sorted({name for name in known if [host for host, _ in hosts].count(name) > 1})
        return "; ".join(
            [
                f"radio: {', '.join(known) or 'nobody'}",
                *(f"{name} by {n} of {self._links} links only" for name, n in hosts if n < self._links),
                *(f"SHUT OUT, not in radio.names: {name}" for name in strangers),
                *(f"TWO HOSTS are {name}: check system.host" for name in twice),
            ]
        )


class Comparison:
    """Asks the ground for its time and publishes what is known of it."""

    def __init__(
        self, node: Node, bus: RadioBus, radio: Radio, time_of_day_ns: Callable[[], int] = time.time_ns
    ) -> None:
        self._node, self._bus, self._radio, self._time_of_day_ns = node, bus, radio, time_of_day_ns
        self._out = node.publisher(RADIO_CLOCK)
        self._answers: tuple[offset.Answer, ...] = ()
        self._apart_s, self._round_trip_s = 0.0, 0.0
        self._asked = self._answered = 0
        self._up = False
        self._heard_ns = -(10**18)

    def turn(self, n: int, connects: int) -> None:
        """Every tenth of a second; asks and publishes as often as the profile says."""
        if n % max(1, round(self._radio.ask_period_s * RATE_HZ)):
            return
        self._publish(connects)
        self._asked += 1
        t_0_ns = self._node.clock.now_ns()
        self._bus.ask(GROUND_CLOCK, lambda reply, t_3_ns: self._take(t_0_ns, reply, t_3_ns), 2.0)

    def _take(self, t_0_ns: int, reply: bytes, t_3_ns: int) -> None:
        t_1_ns, of_day_ns = map(int, json.loads(reply))
        answer = offset.Answer(t_0_ns, t_1_ns, t_3_ns)
        if self._answers and abs(answer.theta_ns - self._answers[-1].theta_ns) > _RESTART_ns:
            self._answers = ()
        self._answers = offset.step(self._answers, answer)
        self._answered += 1
        self._up, self._heard_ns = True, t_3_ns
        self._round_trip_s = (t_3_ns - t_0_ns) * 1e-9
        lag_ns = self._node.clock.now_ns() - (t_0_ns + t_3_ns) // 2
        self._apart_s = (of_day_ns + lag_ns - self._time_of_day_ns()) * 1e-9

    def _publish(self, connects: int) -> None:
        now_ns = self._node.clock.now_ns()
        self._up = now_ns - self._heard_ns < self._radio.lost_s * 1e9
        known = offset.estimate(self._answers, now_ns, self._radio.drift_per_s)
        self._out.publish(
            RadioClock(
                valid=known is not None,
                invalid_reason="" if known else "the ground has not answered yet",
                ground_minus_drone_ns=known.theta_ns if known else 0,
                uncertainty_s=known.uncertainty_ns * 1e-9 if known else 0.0,
                round_trip_s=self._round_trip_s,
                time_of_day_apart_s=self._apart_s,
                up=self._up,
                connects=connects,
                unanswered=self._asked - self._answered,
            )
        )
