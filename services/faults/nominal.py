"""Flights in which nothing breaks: other people, seeds and delays; no alarm above a warning, and every promise kept."""

import asyncio
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from schemas.safety import Action, Level, Phase
from schemas.topics import GUIDANCE, HANDLE_STATE, SAFETY_STATE
from services.config import Config
from services.faults import measure
from services.faults.campaign import unremarked
from services.faults.fault import Fault, Group, Moment, Reaction
from services.rehearsal.chain import Stage, fly
from services.rehearsal.quick import quick_config

LIMIT_S, START_S = 120.0, 0.5
NOTHING = Fault("nothing", Group.PERSON, "nothing breaks", Reaction.NOTHING, 0.0, moment=Moment(Phase.IDLE, START_S))
"""A fault that is none: what must hold whatever breaks must hold all the more where nothing does."""


class Nominal(NamedTuple):
    """One flight: who flew, how it ended, the highest level, what was said above a warning, and broken promises."""

    seed: int
    who: str
    phase: str
    level: Level
    said: tuple[str, ...]
    broken: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Landed, no alarm, and nothing that must hold was missing."""
        return self.phase == Phase.LANDED.value and self.level <= Level.WARN and not self.broken


def flights(count: int, jobs: int, first_seed: int = 1) -> Iterator[Nominal]:
    """`count` flights, `jobs` at once, as they end in order."""
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(flight, range(first_seed, first_seed + count))


def flight(seed: int) -> Nominal:
    """One flight of somebody else over another network, all of it by the seed."""
    draw = np.random.default_rng(seed)
    config, who = _somebody(draw, seed)
    delays_s = dict(
        zip((HANDLE_STATE.key, GUIDANCE.key, SAFETY_STATE.key), draw.uniform(0.0, 0.02, 3).tolist(), strict=True)
    )

    async def script(stage: Stage) -> None:
        stage.bus.latency_s.update(delays_s)
        await asyncio.sleep(START_S)
        stage.ask(Action.START)
        await stage.until(lambda state: state.phase in (Phase.LANDED, Phase.HOLD), LIMIT_S)

    with unremarked():
        flown = fly(config, script)
    states = [m for m in flown.said[SAFETY_STATE.key] if m.phase is not Phase.IDLE]
    said = [m.reasons[0] for m in states if m.level > Level.WARN and m.reasons]
    broken = measure.measure(NOTHING, flown, flown.said[SAFETY_STATE.key][0].stamp_ns * 1e-9 + START_S).broken
    return Nominal(seed, who, states[-1].phase.value, max(m.level for m in states), tuple(dict.fromkeys(said)), broken)


def _somebody(draw: np.random.Generator, seed: int) -> tuple[Config, str]:
    """A person between a light and quick and a heavy and slow one, of 1.55 to 1.8 m, and what is said of them."""
    mass_kg, damping = draw.uniform(3.0, 9.0), draw.uniform(6.0, 14.0)
    height_m, reach_mps = draw.uniform(1.45, 1.65), draw.uniform(0.4, 1.0)
    config = quick_config()
    human = replace(config.person.human, m_H_kg=mass_kg, b_H_Ns_per_m=damping, head_height_m=height_m)
    subject = replace(config.person.subject, reach_speed_mps=reach_mps)
    person = replace(config.person, human=human, subject=subject)
    system = replace(config.system, seed=seed)
    who = f"{mass_kg:.1f} kg, {damping:.0f} N s/m, head at {height_m:.2f} m, reaches at {reach_mps:.1f} m/s"
    return config.model_copy(update={"person": person, "system": system}), who
