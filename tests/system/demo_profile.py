"""A demo of its own: another name on the bus, another MAVLink port, another run folder, so that tests disturb nobody."""

import os
import socket
import subprocess
import sys
from pathlib import Path

from services.profile_file import deploy_folder


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def write_profile(folder: Path, **changes: str) -> Path:
    """The demo profile with a free port; `changes` replace whole values, by their text."""
    text = (deploy_folder() / "profiles" / "demo.toml").read_text()
    text = text.replace("14540", str(free_port())).replace('name = "demo"', f'name = "t{os.getpid()}"')
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    file = folder / "profile.toml"
    file.write_text(text)
    return file


def clew(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """The command line, in a run folder of its own, with SIGINT ignored as a script's background jobs have it."""
    env = os.environ | {"CLEW_RUN_DIR": str(folder / "run")}
    command = [sys.executable, "-P", "-m", "services.console.cli", *arguments]
    return subprocess.Popen(
        ["sh", "-c", 'trap "" INT; exec "$0" "$@"', *command],
        cwd=folder,
        env=env,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def run(folder: Path, *arguments: str, timeout_s: float = 60.0) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    process = clew(folder, *arguments)
    try:
        out, err = process.communicate(timeout=timeout_s)
    finally:
        process.kill()
    return subprocess.CompletedProcess(arguments, process.returncode, out, err)
