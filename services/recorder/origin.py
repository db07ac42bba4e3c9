"""Where a recording comes from: which code, which host, who walked and under which condition."""

import platform
import subprocess
from importlib.metadata import version
from pathlib import Path

from services.config import Config

FORMAT = 2
"""Of what is in a file. 2: messages say by which time their turn went (said_ns), and may be run again."""

PACKAGES = ("clew-hri", "eclipse-zenoh", "mavsdk", "numpy", "scipy", "pydantic", "mcap")


def origin(config: Config) -> dict[str, str]:
    """The metadata `clew.session`."""
    system = config.system
    return {
        "format": str(FORMAT),
        "profile": system.name,
        "vehicle": system.vehicle,
        "path": system.path,
        "person": config.person.name,
        "subject": config.subject,
        "condition": config.condition,
        "seed": str(system.seed),
        "host": platform.node(),
        "machine": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "processor": processor(),
        "git": revision(),
    } | {name: version(name) for name in PACKAGES}


def processor() -> str:
    """Its name, as far as the host tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor())


def revision() -> str:
    """Of the checkout that runs, with a mark where it has changes; empty for an installed package."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return ""
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=5.0, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
