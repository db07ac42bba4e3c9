"""Batches of a campaign in processes of their own."""

import multiprocessing
import signal
from collections.abc import Callable, Generator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from services.campaign import batch

_walked: Any = None
"""In such a process: the seconds that all of them have walked."""


def run(folder: Path, todo: list[int], jobs: int, progress: Callable[[float], None]) -> None:
    """Do the batches `todo`. `progress` is told how many seconds have been walked so far.

    On Ctrl-C the batches under way are finished. Raises KeyboardInterrupt, or what a batch raises.
    """
    context = multiprocessing.get_context("spawn")
    walked = context.Value("d", 0.0)
    with ProcessPoolExecutor(min(jobs, len(todo)), context, _begin, (walked,)) as pool:
        with _without_ctrl_c():  # the processes, which start here, leave it to this one
            waiting: set[Future[None]] = {pool.submit(_run, folder, index) for index in todo}
        try:
            while waiting:
                finished, waiting = wait(waiting, timeout=0.2, return_when=FIRST_COMPLETED)
                for future in finished:
                    future.result()
                progress(walked.value)
        except KeyboardInterrupt:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


@contextmanager
def _without_ctrl_c() -> Generator[None]:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _begin(walked: Any) -> None:
    global _walked
    _walked = walked


def _run(folder: Path, index: int) -> None:
    batch.run(folder, index, _add)


def _add(seconds: float) -> None:
    with _walked.get_lock():
        _walked.value += seconds
