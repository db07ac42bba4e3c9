"""The geometry of a made-up session: where drone, handle and hand are at any time, and what the cable pulls."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path as File

import numpy as np
from numpy.typing import NDArray

from schemas.safety import Permit, Phase
from services.cable import Cable, offset
from services.guiding_controller.maneuver import f_d
from services.guiding_controller.path import Path
from services.guiding_controller.path_file import read
from services.physics import Array

PATH_FILE = File(__file__).parents[2] / "deploy" / "paths" / "paper.toml"
CABLE = Cable(rest_length_m=1.0, k_c_N_per_m=200.0)
WEIGHT_N = 0.03 * 9.80665

# fmt: off
PHASES = (
    (Phase.IDLE, 1.0, Permit.NONE), (Phase.TAKEOFF, 3.0, Permit.POSITION), (Phase.ZEROING, 2.0, Permit.POSITION),
    (Phase.READY, 4.0, Permit.WAIT), (Phase.GUIDING, 0.0, Permit.GUIDE), (Phase.ARRIVED, 2.0, Permit.WAIT),
    (Phase.CLEARING, 2.0, Permit.POSITION), (Phase.LANDING, 2.5, Permit.LAND), (Phase.LANDED, 0.5, Permit.NONE),
)
# fmt: on


@dataclass(frozen=True)
class Scenario:
    """What is known of the session beforehand. The hand is `drift_m sin(πs)` to the left of the path."""

    guiding_s: float = 5.0
    drift_m: float = 0.03
    force_bias_N: tuple[float, float, float] = (0.0, 0.03, 0.04)
    robot_lag_m: tuple[float, float, float] = (0.03, 0.0, 0.04)
    stalls: int = 2
    truth: bool = True
    lands: bool = True
    slack_s: tuple[float, float] = (0.0, 0.0)
    """A stretch of phase 2, from its start, in which the cable is slack."""
    made_J: float = 0.0
    """Energy that the filter made out of nothing, 2 s into phase 2."""
    dropped: dict[str, set[int]] = field(default_factory=dict)
    """Seqs that never reached the recorder, by topic."""


class World:
    """Where everything is at any time, (N,) -> (N, 3)."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.path: Path = read(PATH_FILE, 1.0)
        lengths = [scenario.guiding_s if phase is Phase.GUIDING else length for phase, length, _ in PHASES]
        self.starts = np.append(0.0, np.cumsum(lengths))
        self.end_s = float(self.starts[-1])
        self.start = {phase: float(self.starts[i]) for i, (phase, _, _) in enumerate(PHASES)}

    def phase(self, t: Array) -> NDArray[np.intp]:
        return np.clip(np.searchsorted(self.starts, t, side="right") - 1, 0, len(PHASES) - 1)

    def s(self, t: Array) -> Array:
        return _smooth((t - self.start[Phase.GUIDING] - 0.5) / (self.scenario.guiding_s - 1.0))

    def held(self, t: Array) -> NDArray[np.bool_]:
        return (t > self.start[Phase.READY] + 2.0) & (t < self.start[Phase.CLEARING] - 0.5)

    def hand(self, t: Array) -> Array:
        s = self.s(t)
        return self.path.p(s) + (self.scenario.drift_m * np.sin(np.pi * s))[:, None] * self.path.normal(s)

    def force(self, t: Array) -> Array:
        """On the handle: its weight while it hangs, less than f^d while the hand walks, nothing on the floor."""
        begin = self.start[Phase.GUIDING]
        ramp = _smooth((t - begin) / 2.0)
        wanted = f_d(self.s(t), self.path, 1.0)
        wanted[:, :2] *= (ramp * (1.0 - 0.35 * np.sin(np.pi * self.s(t))))[:, None]
        wanted[:, 2] = WEIGHT_N + (1.0 - WEIGHT_N) * _smooth((t - begin) / 0.3)
        hung = np.where((t > 3.2) & (t < self.start[Phase.CLEARING] + 1.5), WEIGHT_N, 0.0)
        wanted[~self.held(t)] = 0.0
        wanted[~self.held(t), 2] = hung[~self.held(t)]
        lo, hi = self.scenario.slack_s
        wanted[(t >= begin + lo) & (t < begin + hi)] = 0.0
        return wanted

    def robot(self, t: Array) -> Array:
        begin, clear = self.start[Phase.READY], self.start[Phase.CLEARING]
        pull = self.force(t)
        pull[~self.held(t)] = (0.0, 0.0, 1.0)
        p = self.hand(t) + offset(np.where(np.abs(pull).sum(-1, keepdims=True) > 0, pull, (0.0, 0.0, 1.0)), CABLE)
        p[:, 2] -= 1.98 * (1.0 - _smooth((t - 1.0) / 2.8)) * (t < begin)
        p[:, 1] += 0.7 * _smooth((t - clear - 0.3) / 1.5)
        p[:, 2] -= 1.98 * _smooth((t - self.start[Phase.LANDING]) / 2.3)
        return p

    def handle(self, t: Array) -> Array:
        """In the hand, or hanging below the robot and swinging, or on the floor."""
        since = np.maximum(t - self.start[Phase.TAKEOFF] - 2.0, 0.0)
        swing = 0.08 * np.exp(-since / 3.0) * np.sin(3.1 * since)
        hanging = self.robot(t) - (0.0, 0.0, 1.0) + np.stack((swing, -0.7 * swing, 0 * t), axis=-1)
        hanging[:, 2] = np.maximum(hanging[:, 2], 0.02)
        blend = _smooth((t - self.start[Phase.READY] - 1.0) / 1.0) * (t < self.start[Phase.CLEARING] - 0.5)
        return hanging + blend[:, None] * (self.hand(t) - hanging)

    def velocity(self, position: Callable[[Array], Array], t: Array) -> Array:
        return (position(t + 5e-4) - position(t - 5e-4)) * 1e3


def _smooth(x: Array) -> Array:
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)
