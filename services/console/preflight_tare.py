"""What preflight reads in the recordings on this host: how the last zeroing of this vehicle ended."""

from itertools import islice
from pathlib import Path

import numpy as np
from pydantic_core import from_json

from schemas.estimation import Tare
from schemas.topics import CABLE_FORCE
from services.config import Config, ConfigError, of_recording
from services.force_estimator.bias import Bias
from services.force_estimator.preflight import Zeroing, reasons
from services.physics import Z
from services.px4_bridge.preflight import Reason
from services.recorder.reading import Session
from services.recorder.table import Array, Table
from services.recorder.walk import CONFIG_ATTACHMENT
from services.session_files import FILE

LOOKED_INTO = 10
"""The newest recordings; reading one takes about a second."""


def look_at_tare(config: Config, folder: Path) -> list[Reason]:
    """The list for a host that records; empty where nothing is known."""
    if "recorder" not in config.system.services:
        return []
    return [Reason(*each) for each in reasons(last_zeroing(config, folder), config.force_estimator.bias)]


def last_zeroing(config: Config, folder: Path) -> Zeroing | None:
    """Of a vehicle that was believed to be as this one is, in the recordings in `folder`, the newest first."""
    files = sorted((f for f in folder.glob(f"*/{FILE}") if not f.parent.is_symlink()), reverse=True)
    found = (_zeroing(config, file) for file in islice(files, LOOKED_INTO))
    return next((zeroing for zeroing in found if zeroing is not None), None)


def _zeroing(config: Config, file: Path) -> Zeroing | None:
    """None where there is none, of another vehicle, or where it is no sound recording."""
    try:
        session = Session(file)
        recorded = of_recording(file, from_json(session.attachments[CONFIG_ATTACHMENT]))
        if _believed(recorded) != _believed(config):
            return None
        force = session.table(CABLE_FORCE)
    except (ConfigError, KeyError, OSError, ValueError):
        return None
    bias_N = _weighed(force, config.force_estimator.bias)
    return None if bias_N is None else Zeroing(file.parent.name, bias_N)


def _weighed(force: Table, p: Bias) -> Array | None:
    """Of the last zeroing that came to an end, (3,) N, as the estimator weighs it (bias.py)."""
    running = np.concatenate(([False], force["tare"] == Tare.RUNNING, [False]))
    edges = np.flatnonzero(np.diff(running.astype(int)))
    for begin, end in reversed(list(zip(edges[::2], edges[1::2], strict=True))):
        if end < len(force["tare"]) and force["tare"][end] in (Tare.PASSED, Tare.FAILED):
            return force["observed_N"][begin:end].mean(axis=0) - p.handle_weight_N * Z
    return None


def _believed(config: Config) -> tuple[object, ...]:
    """What a bias comes from."""
    p = config.force_estimator
    return config.system.name, p.observer.m_R_kg, p.bias.handle_weight_N, config.px4_bridge.vehicle
