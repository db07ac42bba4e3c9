"""Flies faults: one flight is flown once, and at each moment of it the process is copied, one copy for each fault.

A copy (fork) goes on from exactly the same state, breaks, is watched for some seconds and says what it measured. So a hundred
faults cost little more than the seconds after them. Faults that are there from the start have flights of their own.
"""

import asyncio
import gc
import itertools
import logging
import os
import pickle
import sys
import tempfile
import time
import traceback
from collections.abc import Awaitable, Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from schemas.safety import Action, Phase
from schemas.topics import SAFETY_STATE, TRUTH
from services.config import Config
from services.faults import measure
from services.faults.fault import Fault, Moment
from services.faults.measure import Result
from services.faults.record import NEVER
from services.rehearsal import chain
from services.rehearsal.chain import Flight, Fly, Stage
from services.rehearsal.quick import quick_config, quicker

IDLE_S, ASK_S, FLIGHT_LIMIT_S = 1.0, 0.5, 100.0
FIRST_START = 100
"""Of the numbers that requests to start bear, apart from those of the rows."""
LOOK_S = 0.01
GIVES_WAY = 5
"""Niceness of the copies: what flies in real time beside them goes first."""
Look = Callable[[Fault, Flight, float], None]
"""Called in the copy when it has been watched: for a picture."""


@dataclass
class Copies:
    """The processes under way, at most `jobs` at once, and the folder of their results."""

    jobs: int
    folder: Path
    look: Look | None = None
    under_way: set[int] = field(default_factory=set[int])

    def make(self) -> bool:
        """Copy this process once there is room; true in the copy."""
        while len(self.under_way) >= self.jobs:
            self.wait()
        sys.stdout.flush()
        sys.stderr.flush()
        gc.freeze()  # what the copies share is not for their collectors
        pid = os.fork()
        if pid:
            self.under_way.add(pid)
        else:
            os.nice(GIVES_WAY)
        return pid == 0

    def wait(self) -> None:
        """Until one has ended; of this process's other children none is asked."""
        while not (ended := {pid for pid in self.under_way if os.waitpid(pid, os.WNOHANG)[0]}):
            time.sleep(LOOK_S)
        self.under_way -= ended

    def end(self, fault: Fault, work: Callable[[], tuple[Flight, float] | None]) -> None:
        """In the copy: do it, leave the result, and cease to exist."""
        try:
            if done := work():
                self.leave(fault, *done)
        except BaseException:
            (self.folder / f"{fault.name}.error").write_text(traceback.format_exc())
        finally:
            os._exit(0)

    def leave(self, fault: Fault, flight: Flight, begin_s: float) -> None:
        """The result of one fault, for the process that waits for it."""
        result = measure.measure(fault, flight, begin_s)
        (self.folder / f"{fault.name}.result").write_bytes(pickle.dumps(result))
        if self.look:
            self.look(fault, flight, begin_s)


@contextmanager
def unremarked() -> Generator[None]:
    """Without the services' remarks on what is done to them."""
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(logging.NOTSET)


def campaign(
    faults: Sequence[Fault], jobs: int = 2, look: Look | None = None, config: Config | None = None
) -> list[Result]:
    """The results of `faults`, in their order; what could not be flown is a broken promise."""
    config = quicker(config) if config else quick_config()
    with tempfile.TemporaryDirectory() as folder, unremarked():
        copies = Copies(jobs, Path(folder), look)
        if together := [fault for fault in faults if not fault.alone]:
            chain.fly(config, lambda stage: _reach(stage, together, lambda due: _in_copies(stage, due, copies)))
        for fault in (fault for fault in faults if fault.alone):
            if copies.make():
                copies.end(fault, lambda fault=fault: alone(fault, config))
        while copies.under_way:
            copies.wait()
        return [_result(copies.folder, fault) for fault in faults]


def _result(folder: Path, fault: Fault) -> Result:
    file = folder / f"{fault.name}.result"
    if not file.exists():
        error = folder / f"{fault.name}.error"
        said = error.read_text() if error.exists() else "the copy ended without a word"
        return measure.unmeasured(fault, said)
    result: Result = pickle.loads(file.read_bytes())  # of this program's own making
    return result


async def _reach(stage: Stage, faults: Sequence[Fault], begin: Callable[[list[Fault]], Awaitable[None]]) -> None:
    """Fly the experiment; at each moment let all faults of it begin."""
    waiting: dict[Moment, list[Fault]] = {}
    for fault in faults:
        waiting.setdefault(fault.moment, []).append(fault)
    entered: dict[Phase, float] = {}
    asked, asked_s = itertools.count(FIRST_START), 0.0
    async with asyncio.timeout(FLIGHT_LIMIT_S):
        async for state in stage.operator.stream(SAFETY_STATE):
            entered.setdefault(state.phase, stage.now_s)
            for moment in [m for m in waiting if stage.now_s >= entered.get(m.phase, NEVER) + m.after_s - 1e-9]:
                await begin(waiting.pop(moment))
            if not waiting:
                return
            if state.phase is Phase.IDLE and stage.now_s >= max(entered[Phase.IDLE] + IDLE_S, asked_s + ASK_S):
                asked_s = stage.now_s  # a vehicle is ready when it is ready
                stage.ask(Action.START, next(asked))


async def _in_copies(stage: Stage, faults: list[Fault], copies: Copies) -> None:
    loop = asyncio.get_running_loop()
    stage.flight.said.read(measure.TOPICS)  # once for all copies
    for fault in faults:
        if copies.make():
            asyncio._set_running_loop(loop)  # pyright: ignore[reportPrivateUsage]  (it asks for the process)
            try:
                begin_s = await _broken(fault, stage)
            except BaseException:
                (copies.folder / f"{fault.name}.error").write_text(traceback.format_exc())
                os._exit(1)
            copies.end(fault, lambda begun=begin_s: (stage.flight, begun))


async def _broken(fault: Fault, stage: Stage) -> float:
    """From its moment on: the fault, and what follows. Returns when it began: with the person's deed, or at the moment."""
    if fault.deeds:
        left_s = await _taken_s(stage) + fault.deeds[0].start_s - stage.now_s
        if left_s < 0.0:
            raise ValueError(f"{fault.moment} is {-left_s:.2f} s after the deed of {fault.name} should have begun")
        stage.behave(fault.deeds)
        await asyncio.sleep(left_s)
    begin_s = stage.now_s
    fault.act(stage)
    await asyncio.sleep(fault.watch_s)
    return begin_s


def alone(fault: Fault, config: Config | None = None, fly: Fly = chain.fly) -> tuple[Flight, float]:
    """A flight of its own from the start, and when the fault began in it."""
    config, begun = config or quick_config(), list[float]()

    async def script(stage: Stage) -> None:
        async def here(_: list[Fault]) -> None:
            begun.append(await _broken(fault, stage))

        await _reach(stage, [fault], here)

    configs = {"simulator": fault.world(config)} if fault.world else None
    return fly(config, script, configs=configs), begun[0]


async def _taken_s(stage: Stage) -> float:
    """When the person took the handle; waits for it."""
    async for truth in stage.operator.stream(TRUTH, depth=4096):
        if truth.holding:
            break
    return next(m.stamp_ns for m in stage.flight.said[TRUTH.key] if m.holding) * 1e-9


def processors() -> int:
    """As many as there are for this process."""
    return len(os.sched_getaffinity(0))
