"""The whole system on virtual time, for tests: whatever a script breaks, the filter must be passive at its ports throughout."""

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

from schemas.energy import EnergyBalance
from schemas.topics import ENERGY
from services.config import Config
from services.px4_bridge.energy import ROUNDING_J
from services.rehearsal import chain
from services.rehearsal.chain import Flight, Script


def fly(
    config: Config,
    script: Script,
    limit_s: float = 200.0,
    record: Path | None = None,
    configs: Mapping[str, Config] | None = None,
) -> Flight:
    """As services.rehearsal.chain.fly, with the books of the flight checked."""
    flown = chain.fly(config, script, limit_s, record, configs)
    check_balance(flown.said[ENERGY.key])
    return flown


def check_balance(books: list[EnergyBalance]) -> None:
    """The balance of services/px4_bridge/energy.py to its stated error: rounding, on the side of energy made."""
    residual = [0.0, *(m.residual_J for m in books)]
    assert all(m.created_J <= ROUNDING_J for m in books), "the filter made energy"
    assert all(b >= a - ROUNDING_J for a, b in pairwise(residual)), "the residual fell"
    assert all(m.tank_J >= 0.0 for m in books)
    for m in books:
        supplied = m.handed_J + m.guidance_J + m.height_J + m.cable_J + m.hand_J
        assert abs(m.stored_J + m.dissipated_J + m.residual_J - supplied) < ROUNDING_J
