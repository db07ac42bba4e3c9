"""From a name to a running service, and from a profile to the processes of a set."""

import asyncio
import importlib
import sys
from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from schemas.topics import GATEWAYS, SERVICES
from services.config import Config, ConfigError, load, told_in
from services.console import vehicle_link
from services.runtime.bus_config import AlreadyRunning, BusConfig, claim, default_run_dir
from services.runtime.clock import Clock, MonotonicClock
from services.runtime.launcher import Launched, ServiceDied, launch
from services.runtime.process import serve
from services.runtime.zenoh_bus import ZenohBus
from services.tracker import capture
from services.tracker.bodies import SIMULATED


@dataclass(frozen=True, kw_only=True)
class Choice:
    """What a user chooses for a run; names are those of deploy/ or files."""

    profile: str
    path: str = ""
    person: str = ""
    seed: int | None = None
    px4: str = ""
    subject: str = ""
    condition: str = ""
    out: Path = Path("sessions")

    def config(self) -> Config:
        """Validated, with certificates and devices of this host, and a new session folder.

        Raises ConfigError, OSError, and AlreadyRunning where the system is up.
        """
        config = load(self.profile, path=self.path, person=self.person, seed=self.seed, px4=self.px4)
        with told_in(self.profile):
            check_radio(config)
            check_alone(config)
            check_devices(config, config.system.services)
            check_px4(config)
        folder = str(new_session(self.out).resolve())
        return config.model_copy(update={"subject": self.subject, "condition": self.condition, "session_dir": folder})


def bus_config(config: Config) -> BusConfig:
    """Where the services of this system find each other."""
    return BusConfig(
        system=config.system.name,
        run_dir=default_run_dir(),
        services=config.system.services,
        placement=config.placement(),
    )


def check_radio(config: Config) -> None:
    """Certificates and addresses of this host, before anything starts. Raises ConfigError."""
    if config.hosts and config.system.host in GATEWAYS:
        from services.gateway.start import gateway_bus

        gateway_bus(config, bus_config(config))


def check_alone(config: Config) -> None:
    """No service of this system runs on this host yet. Raises AlreadyRunning."""
    for name in config.system.services:
        with claim(bus_config(config), name):
            pass


def check_devices(config: Config, services: Sequence[str]) -> None:
    """Of those services: the vehicle's link and the capture system's client, before anything starts. Raises ConfigError."""
    if "px4_bridge" in services:
        vehicle_link.check(config.px4_bridge.link.url)
    if "tracker" in services and config.tracker.source != SIMULATED and config.tracker.mocap:
        capture.check(config.tracker.source, config.tracker.mocap)


def check_px4(config: Config) -> None:
    """PX4 in software, where it is to be started: its program and its port. Raises ConfigError."""
    if "simulator" not in config.system.services or config.simulator.px4_sitl is None:
        return
    from services.simulator import px4_process  # with it, the autopilot's messages

    try:
        px4_process.check(config.simulator.px4_sitl)
    except px4_process.Px4NotThere as error:
        raise ConfigError(str(error)) from None


def services_of(config: Config) -> tuple[str, ...]:
    """Of the whole system, on both hosts where there are two."""
    return tuple(n for host in config.hosts.values() for n in host.services) or config.system.services


def observer_bus(config: Config) -> BusConfig:
    """For tools: on one of the hosts, or over the radio from a console. Raises ConfigError as a gateway's start does."""
    if config.system.host != "console":
        return bus_config(config)
    from services.gateway.start import console_bus

    return console_bus(config, bus_config(config))


def clock_of(config: Config, bus: ZenohBus) -> Clock:
    """A tool's clock: this host's; a console lives on the ground's, as far as it can be told over the radio."""
    if config.system.host != "console":
        return MonotonicClock()
    from services.gateway.console import ground_clock

    return ground_clock(bus)


def run_service(name: str, config: Config) -> int:
    """Run one service in this process. Returns the exit code."""
    module, buses = importlib.import_module(module_of(name)), bus_config(config)
    if name in GATEWAYS.values():
        from services.gateway.start import gateway_bus  # with it, the certificates' library

        buses = gateway_bus(config, buses)
    return serve(name, module.run, config, buses)


def module_of(name: str) -> str:
    """A service's module is named like it; both gateways are one."""
    return f"services.{'gateway' if name in GATEWAYS.values() else name}.service"


def new_session(out: Path) -> Path:
    """A folder named after the local time under `out`, and `out/latest` pointing at it."""
    name = datetime.now().astimezone().strftime("%Y-%m-%dT%H-%M-%S")
    folder = out / name
    for n in range(1, 100):
        if not folder.exists():
            break
        folder = out / f"{name}-{n}"
    folder.mkdir(parents=True)
    latest = out / "latest"
    latest.unlink(missing_ok=True)
    latest.symlink_to(folder.name)
    return folder


@asynccontextmanager
async def launch_all(config: Config, timeout_s: float = 30.0) -> AsyncGenerator[Launched]:
    """Every service of the profile as a process; the resolved configuration and the logs are in `config.session_dir`.

    Raises:
        ServiceDied, TimeoutError: naming the service, when it ends at start or does not come up.
    """
    folder = Path(config.session_dir)
    resolved = folder / "config.json"
    resolved.write_text(config.model_dump_json(indent=1))
    command = [sys.executable, "-P", "-m", "services.console.cli", "run", "--profile", str(resolved)]
    commands = {name: [*command, name] for name in config.system.services}
    async with launch(commands, bus_config(config), folder / "logs", timeout_s) as launched:
        yield launched


def run_by_hand(name: str, profile: str, px4: str = "") -> int:
    """`clew run`: one service in the foreground; 2 for bad configuration or a name that does not exist.

    `gateway` is this host's.
    """
    try:
        if name not in (*SERVICES, "gateway"):
            raise ConfigError(f"service {name!r}: must be one of {', '.join(SERVICES)}")
        config = load(profile, px4=px4)
        if name == "gateway":
            name = GATEWAYS.get(config.system.host, name)
        keeps = name == "recorder" or (name == "simulator" and config.simulator.px4_sitl is not None)
        if not config.session_dir and keeps:
            config = config.model_copy(update={"session_dir": str(new_session(Path("sessions")).resolve())})
        with told_in(profile):
            check_devices(config, (name,))
            return run_service(name, config)
    except ConfigError as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2


def chosen(choice: Choice) -> Config | int:
    """The configuration; or, once a line has said why not, the exit code: 1 where the system is up, 2 for bad input."""
    try:
        return choice.config()
    except (ConfigError, OSError, AlreadyRunning) as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 1 if isinstance(error, AlreadyRunning) else 2


def up(choice: Choice) -> int:
    """`clew up`: all services of a profile, until Ctrl-C or until one ends."""
    config = chosen(choice)
    if isinstance(config, int):
        return config

    async def stay() -> str:
        async with launch_all(config) as launched:
            print(f"up: {', '.join(config.system.services)}; session {config.session_dir}; Ctrl-C stops")  # noqa: T201
            return await launched.wait()

    try:
        print(f"{asyncio.run(stay())} ended")  # noqa: T201
    except KeyboardInterrupt:
        return 0
    except (ServiceDied, TimeoutError) as error:
        print(f"clew up: {error}", file=sys.stderr)  # noqa: T201
        return 1
    return 0
