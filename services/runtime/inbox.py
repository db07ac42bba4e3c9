"""The border where bytes become messages: one inbox for each topic that a node reads, each payload decoded once."""

from collections.abc import Callable
from functools import lru_cache
from typing import Generic, NamedTuple, TypeVar, cast

from schemas.message import Message
from schemas.topics import Topic
from services.runtime.bus import Bus, Mailbox, MAX_PAYLOAD_bytes
from services.runtime.hosts import Hosts
from services.runtime.turn import Turn

M = TypeVar("M", bound=Message)

QUIET_ns = 1_000_000_000
"""After this silence a smaller seq is a new publisher even if its stamps are older (its host was restarted)."""
VOICES = 16
"""So many consoles are told apart; then the one that was silent longest is forgotten."""


@lru_cache(maxsize=64)
def _parsed(kind: type[Message], payload: bytes) -> Message:
    """In a process that is the whole system each message is read once for all who hear it; it cannot be changed."""
    return kind.model_validate_json(payload, strict=True)


class _Heard(NamedTuple):
    """The last of one voice."""

    seq: int
    stamp_ns: int
    received_ns: int


class Inbox(Generic[M]):
    """Holds the newest message of a topic and hands each to the `taps`, in order. Bad input is counted, never kept.

    It looks into the bus's mailbox when it is read, once in each turn of the loop; `wake` makes the bus call instead.
    """

    def __init__(
        self, topic: Topic[M], bus: Bus, turn: Turn, reject: Callable[[str, str], None], hosts: Hosts | None = None
    ) -> None:
        self.topic = topic
        self.turn = turn
        self.hosts = hosts or Hosts()
        self.message: M | None = None
        """As it was said: stamped by its publisher's clock."""
        self.obeys = True
        """Whether its reader acts on commands; who only watches may look rarely, and sees them old."""
        self.received_ns = 0
        self.received = 0
        self.restarts = 0
        self.taps: list[Callable[[M], None]] = []
        self.reject = reject
        self._voices: dict[str, _Heard] = {}
        self._bus = bus
        self._mailbox: Mailbox | None = None
        self._looked = -1
        self._wakes = False

    def listen(self) -> None:
        """Let the bus keep what arrives until somebody looks."""
        if self._mailbox is None and not self._wakes:
            self._mailbox = self._bus.mailbox(self.topic.key)

    def look(self) -> None:
        """Take what has arrived; nothing more until the loop's next turn."""
        if self._looked == self.turn.number or self._wakes or self._mailbox is None:
            return
        self._looked = self.turn.number
        self.turn.now_ns()  # a turn that has been looked into must come to an end
        for key, payload in self._mailbox():
            self.on_payload(key, payload)

    def wake(self) -> None:
        """From now on the bus calls on each arrival."""
        if not self._wakes:
            self.look()
            self._wakes, self._mailbox = True, None
            self._bus.subscribe(self.topic.key, self.on_payload)

    def on_payload(self, key: str, payload: bytes) -> None:
        """Take what the bus delivers; refuse what is not a new, well-formed message of this topic."""
        now_ns = self.turn.now_ns()
        try:
            message = self._decode(key, payload)
            self._check_order(message, now_ns)
            self._check_lifetime(message, now_ns)
        except ValueError as why:
            self.reject(self.topic.key, " ".join(str(why).split()))
            return
        self._remember(message, now_ns)
        self.message = message
        self.received_ns = now_ns
        self.received += 1
        for tap in self.taps:
            tap(message)

    def _decode(self, key: str, payload: bytes) -> M:
        if key != self.topic.key:  # a put on a wildcard is legal
            raise ValueError(f"was put on {key}")
        if not 0 < len(payload) <= MAX_PAYLOAD_bytes:
            raise ValueError(f"deleted, larger than {MAX_PAYLOAD_bytes} bytes, or not packed as its topic is")
        return cast(M, _parsed(self.topic.type, payload))

    def _check_order(self, message: M, now_ns: int) -> None:
        last = self._voices.get(message.voice)
        if message.seq < 1:
            raise ValueError("seq is 0: not sent by a publisher")
        if last is None or message.seq > last.seq:
            return
        # One publisher's stamps never fall while its seq rises: a later stamp tells a restart from an old sample.
        if message.stamp_ns <= last.stamp_ns and now_ns - last.received_ns < QUIET_ns:
            raise ValueError(f"seq {message.seq} after {last.seq}: repeated or out of order")
        self.restarts += 1

    def _remember(self, message: M, now_ns: int) -> None:
        self._voices.pop(message.voice, None)
        if len(self._voices) == VOICES:
            del self._voices[next(iter(self._voices))]
        self._voices[message.voice] = _Heard(message.seq, message.stamp_ns, now_ns)

    def _check_lifetime(self, message: M, now_ns: int) -> None:
        """A command is obeyed while it is young; one from the future was not said by this publisher's clock."""
        topic = self.topic
        if topic.lifetime_s == float("inf") or not self.obeys:
            return
        here_ns = self.hosts.here_ns(topic.publisher, message.stamp_ns)
        if here_ns is None:
            raise ValueError("its age is not known: the clocks of the two hosts have not been compared")
        age_ns, allowance_ns = now_ns - here_ns, self.hosts.allowance_ns(topic.publisher)
        if age_ns > topic.lifetime_s * 1e9 + allowance_ns:
            raise ValueError(f"{age_ns * 1e-9:.3f} s old: it lives {topic.lifetime_s + allowance_ns * 1e-9:g} s")
        if -age_ns > self.hosts.ahead_ns(topic.publisher):
            raise ValueError(f"its stamp lies {-age_ns * 1e-9:.3f} s in the future")
