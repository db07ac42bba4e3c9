"""A hand that is led, and the services alone with it."""

from typing import Any

import numpy as np

from schemas.topics import CABLE_FORCE, MOCAP_FRAME, VEHICLE_STATE
from services import cable
from services.config import load
from services.physics import Array
from services.tracker import service as tracker
from tests.services.alone import Feed, Said, alone, force, lasting, vehicle

CONFIG = load("demo")
HAND = CONFIG.guided_path.p(0.2)
PULL = np.array([1.2, 0.0, 1.0])
SLACK = np.array([0.0, 0.0, 0.2])
ABOVE = HAND + cable.offset(PULL, CONFIG.cable)


def serving(module):
    """A service as the launcher runs it."""
    return lambda stage: module.run(stage.node(module.__name__.split(".")[1]), CONFIG)


def tracked(frames: Feed, seconds: float = 1.0, *, pull: Array | None = PULL, frozen: bool = False) -> Said:
    """What the tracker makes of frames; `pull` None: neither vehicle nor force is heard. One that is felt has noise."""
    noise = 0.0 if frozen else 1e-6
    others: dict[Any, Feed] = (
        {}
        if pull is None
        else {VEHICLE_STATE: lambda _: vehicle(ABOVE), CABLE_FORCE: lambda t_s: force(pull * (1.0 + noise * t_s))}
    )
    return alone(serving(tracker), {MOCAP_FRAME: frames, **others}, lasting(seconds))
