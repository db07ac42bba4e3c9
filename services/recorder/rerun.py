"""A service's recorded inputs through the present code, turn by turn on virtual time: the same bytes, or what differs.

What a turn depended on is in the header of the message it published: `said_ns` is the time it went by, `inputs` the tick
and the messages it had taken in. A service whose loop stays silent in a turn must have forgotten everything by then; it
begins anew with its next message, as after a restart.
"""

import asyncio
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from schemas.message import MISSED, TICK, Message
from schemas.topics import TOPICS, Topic
from services.config import Config
from services.recorder.difference import Difference, difference
from services.recorder.reading import Session
from services.recorder.rerun_node import RecordedBus, RerunNode
from services.recorder.rerun_subjects import SUBJECTS, Subject
from services.recorder.table import Row
from services.recorder.tape import Tape
from services.runtime.virtual import VirtualLoop, run_virtual

_PATIENCE = 50  # turns of the event loop that a service may take to answer one of its own


class CannotRerun(ValueError):
    """The recording lacks what a rerun needs; the text says what."""


@dataclass
class Outcome:
    """Of one service. `first` is the earliest message that differs; `notes` say what the recording could not tell."""

    service: str
    said: dict[str, list[bytes]]
    compared: int = 0
    differ: int = 0
    first: Difference | None = None
    notes: list[str] = field(default_factory=list[str])
    recorded_s: float = 0.0
    took_s: float = 0.0

    @property
    def equal(self) -> bool:
        """Whether every message came out again with the same bytes."""
        return self.compared > 0 and self.first is None

    def compare(self, topic: Topic[Message], recorded: bytes | None, said: bytes | None, t_s: float) -> None:
        """Take one pair; None is a message that only the other side has."""
        self.compared += 1
        if recorded != said:
            self.differ += 1
            self.first = self.first or difference(topic.key, recorded, said, t_s)


def rerun(session: Session, name: str, config: Config) -> Outcome:
    """Run one service on all of a session.

    Raises:
        CannotRerun: the recording has none of its messages, or is older than the headers that this needs, or was made on
            the other host, where not all that the service took in arrives.
    """
    if thinned := thinned_for(name, config):
        host = config.host_of(name)
        raise CannotRerun(
            f"{name}: {', '.join(thinned)} crossed the radio thinned; a recorder on the {host} has it whole"
        )
    subject, began = SUBJECTS[name], time.perf_counter()
    tape = Tape(session, name)
    turns = tape.rows(subject.turns.key)
    if not turns:
        raise CannotRerun(f"{name}: nothing of {subject.turns.key} was recorded")
    if not turns[-1].get("said_ns"):
        raise CannotRerun(f"{name}: {subject.turns.key} has no said_ns: the recording is older than reruns")
    outcome = Outcome(name, {topic.key: [] for topic in (subject.turns, *subject.also)})
    outcome.recorded_s = (turns[-1]["said_ns"] - turns[0]["said_ns"]) * 1e-9
    if turns[0]["seq"] > 1:
        outcome.notes.append(f"the first {turns[0]['seq'] - 1} of {subject.turns.key} were not recorded")
    for life in _lives(turns):
        run_virtual(_Life(subject, config, tape, outcome).live(life))
    _compare_others(subject, tape, outcome)
    outcome.took_s = time.perf_counter() - began
    return outcome


def thinned_for(name: str, config: Config) -> list[str]:
    """Topics that the service had whole, or said, on its own host, while the recorder on the other heard some of them."""
    here = config.host_of(name)
    if here == config.host_of("recorder"):
        return []
    own = [topic for topic in TOPICS if name in (topic.publisher, *topic.subscribers)]
    return [topic.key for topic in own if topic.radio_Hz and config.host_of(topic.publisher) == here]


def _lives(turns: Sequence[Row]) -> Iterator[range]:
    """Positions of messages between which the service neither started anew nor spent a turn in silence."""
    begin = 0
    for i in range(1, len(turns)):
        last, now = turns[i - 1], turns[i]
        silent = now["inputs"].get(TICK, 0) - last["inputs"].get(TICK, 0) > now["seq"] - last["seq"]
        if now["seq"] <= last["seq"] or silent:
            yield range(begin, i)
            begin = i
    yield range(begin, len(turns))


def _compare_others(subject: Subject, tape: Tape, outcome: Outcome) -> None:
    """What a service says now and then is compared in order."""
    for topic in subject.also:
        recorded, said = tape.payloads(topic.key), outcome.said[topic.key]
        times = [tape.said_ns(topic.key, i) for i in range(len(recorded))]
        for i in range(max(len(recorded), len(said))):
            one = recorded[i] if i < len(recorded) else None
            other = said[i] if i < len(said) else None
            outcome.compare(topic, one, other, tape.t_s(times[min(i, len(times) - 1)]) if times else 0.0)


class _Life:
    """A service from one start to the next."""

    def __init__(self, subject: Subject, config: Config, tape: Tape, outcome: Outcome) -> None:
        self._subject, self._config, self._tape, self._outcome = subject, config, tape, outcome
        self._bus = RecordedBus()
        self._node = RerunNode(outcome.service, self._bus, config.placement(config.host_of(outcome.service)))
        self._taken: dict[str, int] = {}

    async def live(self, turns: range) -> None:
        """Every turn in order, each with its own time, tick and messages."""
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        task = asyncio.create_task(self._subject.run(self._node, self._config))
        await _settle()
        try:
            for i in turns:
                row = self._tape.rows(self._subject.turns.key)[i]
                loop.now_ns = row["said_ns"]
                self._begin(row)
                await self._turn(row, self._tape.said_ns(self._subject.turns.key, i), task)
                self._collect(i)
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    def _begin(self, row: Row) -> None:
        """The counters of what is published stand where they stood."""
        self._node.publisher(self._subject.turns).seq = row["seq"] - 1
        for topic in self._subject.also:
            publisher, said = self._node.publisher(topic), len(self._outcome.said[topic.key])
            if not publisher.seq and said < len(self._tape.rows(topic.key)):
                publisher.seq = self._tape.rows(topic.key)[said]["seq"] - 1

    async def _turn(self, row: Row, by_ns: int, task: "asyncio.Task[None]") -> None:
        """Hand over what was taken in, the tick or the awaited message last, and wait for the answer."""
        inputs = {key: seq for key, seq in row["inputs"].items() if key not in (TICK, MISSED)}
        for key in sorted(inputs, key=lambda key: key in self._bus.awaited):
            self._deliver(key, inputs[key], row, by_ns)
        if TICK in row["inputs"]:
            self._node.tick(row["inputs"][TICK] - 1, row["inputs"].get(MISSED, 0))
        for _ in range(_PATIENCE):
            await asyncio.sleep(0)
            if task.done():
                task.result()
            if any(key == self._subject.turns.key for key, _ in self._bus.said):
                break
        await asyncio.sleep(0)

    def _deliver(self, key: str, seq: int, row: Row, by_ns: int) -> None:
        place, last = self._tape.place(key, seq, by_ns), self._taken.get(key)
        if place is None:
            self._note(f"{self._subject.turns.key} {row['seq']} used {key} {seq}, which was not recorded")
        elif place != last:
            every = key in self._node.queued and last is not None and last < place
            first = last + 1 if every and last is not None else place
            self._bus.deliver(key, self._tape.payloads(key)[first : place + 1])
            self._taken[key] = place

    def _note(self, text: str) -> None:
        if len(self._outcome.notes) < 5:
            self._outcome.notes.append(text)

    def _collect(self, i: int) -> None:
        said = [payload for key, payload in self._bus.said if key == self._subject.turns.key]
        key, t_s = self._subject.turns.key, self._tape.t_s(self._tape.said_ns(self._subject.turns.key, i))
        recorded = self._tape.payloads(key)[i]
        self._outcome.compare(self._subject.turns, recorded, said[0] if said else None, t_s)
        for topic, payload in self._bus.said:
            if topic in self._outcome.said:
                self._outcome.said[topic].append(payload)
        self._bus.said.clear()


async def _settle() -> None:
    for _ in range(5):
        await asyncio.sleep(0)
