"""`clew demo`: the paper's experiment once, every service a process, from take-off to landing, then what it was like."""

import asyncio
import os
import sys
from collections.abc import Generator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path

from rich.console import Console
from rich.live import Live

from schemas.safety import Action, Phase, SafetyState
from schemas.topics import SAFETY_STATE
from services.config import Config
from services.console import keys, report
from services.console.operator import Operator, operator_node
from services.console.panel import Watch, line, render
from services.console.start import Choice, bus_config, chosen, launch_all
from services.recorder import figures, page, reading, summary
from services.runtime.clock import MonotonicClock
from services.runtime.launcher import ServiceDied
from services.runtime.node import Node
from services.runtime.readers import Latest
from services.runtime.zenoh_bus import open_bus

TIME_LIMIT_S = 130.0
LIVE_HZ = 8.0


class DemoFailed(RuntimeError):
    """The flight could not be begun or did not end; the text says why."""


def demo(choice: Choice, live: bool) -> int:
    """Fly, then report. Returns the exit code: 0 when the flight met its limits, 1 when not, 2 for bad configuration."""
    console = Console()
    config = chosen(choice)
    if isinstance(config, int):
        return config
    folder = Path(os.path.relpath(config.session_dir))
    try:
        asyncio.run(fly(config, console, live=live))
    except (DemoFailed, ServiceDied, TimeoutError) as error:
        print(f"clew demo: {error}\nlogs: {folder}/logs", file=sys.stderr)  # noqa: T201
        return 1
    except KeyboardInterrupt:
        print(f"\nstopped; the recording is {folder}/session.mcap", file=sys.stderr)  # noqa: T201
        return 130
    return tell(folder, console)


def tell(folder: Path, console: Console) -> int:
    """Summary, figures and table of a recorded session."""
    session = reading.read(folder / "session.mcap")
    result = summary.summarise(session)
    (folder / "summary.json").write_text(result.to_json())
    figures.draw_all(session, folder)
    page.write_page([session], folder / "report.html")
    report.show(result, folder, console)
    return 0 if result.ok else 1


async def fly(config: Config, console: Console, *, live: bool) -> None:
    """Start everything, ask for the start, watch until the vehicle has landed.

    Raises:
        ServiceDied, TimeoutError, DemoFailed: with the reason in words.
    """
    with open_bus(bus_config(config), f"operator-{os.getpid()}") as bus:
        node = operator_node(bus, MonotonicClock(), config.placement())
        watch, operator = Watch(node, config.system.services), Operator(node)
        console.print(f"session {config.session_dir}")
        async with launch_all(config) as launched:
            with _screen(console, live) as screen, _keys(operator, watch, screen is not None):
                watching = asyncio.create_task(_watch(watch, screen, console))
                dying = asyncio.create_task(launched.wait())
                flying = asyncio.create_task(_experiment(node, operator))
                try:
                    await asyncio.wait((flying, dying), return_when=asyncio.FIRST_COMPLETED)
                    if dying.done():
                        raise DemoFailed(f"{dying.result()} ended before the flight did")
                    await flying
                finally:
                    for task in (watching, dying, flying):
                        task.cancel()
                    await asyncio.gather(watching, dying, flying, return_exceptions=True)


async def _experiment(node: Node, operator: Operator) -> None:
    """Start, and wait for the landing."""
    safety = node.latest(SAFETY_STATE)
    try:
        async with asyncio.timeout(TIME_LIMIT_S):
            await _started(safety, operator)
            async for state in node.stream(SAFETY_STATE):
                if state.phase in (Phase.LANDED, Phase.KILLED):
                    break
            await asyncio.sleep(1.0)  # the recording shows it standing
    except TimeoutError:
        state = safety.message
        phase = f"phase {state.phase}: {'; '.join(state.reasons)}" if state else "the supervisor is silent"
        raise DemoFailed(f"not landed after {TIME_LIMIT_S:g} s, {phase}") from None


async def _started(safety: Latest[SafetyState], operator: Operator) -> None:
    """Ask until the vehicle takes off: it may not be ready at once."""
    while safety.message is None or safety.message.phase is Phase.IDLE:
        await operator.ask(Action.START, timeout_s=1.0)
        await asyncio.sleep(0.2)


def _screen(console: Console, live: bool) -> AbstractContextManager[Live | None]:
    return (
        Live(console=console, refresh_per_second=LIVE_HZ, transient=True)
        if live and console.is_terminal
        else nullcontext()
    )


@contextmanager
def _keys(operator: Operator, watch: Watch, live: bool) -> Generator[None]:
    """Under the live panel a key is a command, and its last line says what came of it."""
    given: set[asyncio.Task[bool]] = set()

    def tell(text: str) -> None:
        watch.footer = text

    def act(action: Action) -> None:
        given.add(task := asyncio.create_task(operator.command(action, tell)))
        task.add_done_callback(given.discard)

    if not live:
        yield
        return
    with keys.listening(act) as there:
        watch.footer = keys.HINT if there else ""
        yield


async def _watch(watch: Watch, screen: Live | None, console: Console) -> None:
    """The live panel, or one line a second without a terminal."""
    while True:
        if screen is not None:
            screen.update(render(watch.view()))
            await asyncio.sleep(1.0 / LIVE_HZ)
        else:
            console.print(line(watch.view()), soft_wrap=True, highlight=False)
            await asyncio.sleep(1.0)
