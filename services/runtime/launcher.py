"""Services as processes of one host: started together, watched, and stopped together."""

import asyncio
import os
import signal
from asyncio.subprocess import Process
from collections.abc import AsyncGenerator, Iterable, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

from services.runtime.bus_config import BusConfig
from services.runtime.zenoh_bus import open_bus

STOP_s = 2.0
_TAIL_lines = 15


class ServiceDied(RuntimeError):
    """Says which service, how it ended, and its last words."""


class Launched:
    """Services that run. The output of each is in `<log_dir>/<name>.log`."""

    def __init__(self, log_dir: Path) -> None:
        self.processes: dict[str, Process] = {}
        self.alive: set[str] = set()
        self._log_dir = log_dir
        log_dir.mkdir(parents=True, exist_ok=True)
        self._ended: dict[str, int] = {}
        self._watchers: dict[str, asyncio.Task[None]] = {}
        self._changed = asyncio.Event()

    async def start(self, name: str, command: Sequence[str], env: Mapping[str, str]) -> None:
        """Start one; a session of its own keeps the terminal's Ctrl-C away from it, so that only `stop` asks."""
        with self._log(name).open("wb") as log:
            process = await asyncio.create_subprocess_exec(
                *command, stdin=asyncio.subprocess.DEVNULL, stdout=log, stderr=log, env=env, start_new_session=True
            )
        self.processes[name] = process
        self._watchers[name] = asyncio.create_task(self._watch(name, process))

    async def until_alive(self, timeout_s: float) -> None:
        """Return when each service has announced itself.

        Raises:
            ServiceDied: one ended instead.
            TimeoutError: some did not within `timeout_s`; the message names them.
        """
        try:
            async with asyncio.timeout(timeout_s):
                while self._missing():
                    await self._change()
                    self._raise_ended(of=self._missing())
        except TimeoutError:
            missing = self._missing()
            words = "\n".join(self._last_words(name) for name in missing)
            raise TimeoutError(f"not alive after {timeout_s:g} s: {', '.join(missing)}\n{words}") from None

    async def wait(self) -> str:
        """Return the name of the first service that finishes by itself.

        Raises:
            ServiceDied: it ended with an error, or was killed.
        """
        while not self._ended:
            await self._change()
        name, code = next(iter(self._ended.items()))
        if code:
            self._raise_ended(of=[name])
        return name

    async def stop(self) -> None:
        """SIGINT to all but the first that was started, then to it, so that a recorder hears the others out.

        After 2 s in all, SIGKILL; returns when all are gone.
        """
        first, *others = self.processes or [""]
        await self._ask(others, 0.6 * STOP_s)
        await self._ask([first], 0.4 * STOP_s)
        self._signal(self.processes, signal.SIGKILL)
        await asyncio.gather(*self._watchers.values())

    def on_presence(self, name: str, alive: bool) -> None:
        """The bus reports who comes and goes."""
        (self.alive.add if alive else self.alive.discard)(name)
        self._changed.set()

    async def _watch(self, name: str, process: Process) -> None:
        self._ended[name] = await process.wait()
        self._changed.set()

    async def _change(self) -> None:
        self._changed.clear()
        await self._changed.wait()

    def _missing(self) -> list[str]:
        return [name for name in self.processes if name not in self.alive]

    def _raise_ended(self, of: Sequence[str]) -> None:
        for name in of:
            if (code := self._ended.get(name)) is not None:
                how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
                raise ServiceDied(f"{name} {how}\n{self._last_words(name)}")

    async def _ask(self, names: Iterable[str], timeout_s: float) -> None:
        """SIGINT, and wait until they have ended or the time is over."""
        asked = [name for name in names if name in self.processes]
        self._signal(asked, signal.SIGINT)
        if asked:
            await asyncio.wait([self._watchers[name] for name in asked], timeout=timeout_s)

    def _signal(self, names: Iterable[str], number: signal.Signals) -> None:
        for name in names:
            if name not in self._ended and self.processes[name].returncode is None:
                self.processes[name].send_signal(number)

    def _log(self, name: str) -> Path:
        return self._log_dir / f"{name}.log"

    def _last_words(self, name: str) -> str:
        lines = self._log(name).read_text(errors="replace").splitlines()[-_TAIL_lines:]
        return "\n".join(f"  {name}: {line}" for line in lines) or f"  {name}: said nothing"


@asynccontextmanager
async def launch(
    commands: Mapping[str, Sequence[str]], config: BusConfig, log_dir: Path, timeout_s: float = 20.0
) -> AsyncGenerator[Launched]:
    """Start a command for each service and wait until all are alive; on leaving, stop them all.

    They end with this process, however it ends; enter from a thread that lives as long as they shall.

    Raises:
        ServiceDied, TimeoutError: as `Launched.until_alive`.
    """
    env = {**os.environ, "CLEW_RUN_DIR": config.run_dir, "CLEW_DIE_WITH_PARENT": str(os.getpid())}
    launched = Launched(log_dir)
    with open_bus(config, f"launcher-{os.getpid()}") as bus:
        bus.watch(launched.on_presence)
        try:
            for n, (name, command) in enumerate(commands.items()):
                await launched.start(name, command, env)
                if n == 0:  # a recorder hears even the first words of the others
                    await launched.until_alive(timeout_s)
            await launched.until_alive(timeout_s)
            yield launched
        finally:
            await launched.stop()
