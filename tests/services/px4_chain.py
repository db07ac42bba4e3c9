"""PX4's program, and the profile that flies it."""

import os
from pathlib import Path

from services.config import Config, load

PX4_BIN = os.environ.get("PX4_BIN", "")


def px4_config(folder: Path, seed: int = 1) -> Config:
    """The profile with PX4_BIN, its session in `folder`."""
    return load("px4-sitl", seed=seed, px4=PX4_BIN, session_dir=str(folder))
