"""Where the vehicle flies in position mode: over the start, and the way down at the end (G10).

Coming straight down would land on the handle and beside the person. So: away from the person along the last direction of
the path, down until the handle rests on the floor, aside by more than the cable can reach back, and only then land. It is
drawn from the end of the path, and moved to where it begins.
"""

import numpy as np

from services.cable import Cable
from services.guiding_controller.path import Path
from services.physics import Array, Z
from services.safety_supervisor.phases import Hall, Plan

HORIZONTAL = np.array([1.0, 1.0, 0.0])
WALL_M = 0.5  # that a route keeps from the walls


def hall(path: Path, cable: Cable, handle_weight_N: float, volume_min: Array, volume_max: Array) -> Hall:
    """Where a landing may go that begins anywhere on the path."""
    walls = WALL_M * HORIZONTAL
    return Hall(hover(path.p(1.0), handle_weight_N, cable), volume_min + walls, volume_max - walls)


def hover(p_H: Array, handle_weight_N: float, cable: Cable) -> Array:
    """Where the vehicle hangs the free handle at `p_H`, (3,) m."""
    return p_H + (cable.rest_length_m + handle_weight_N / cable.k_c_N_per_m) * Z


def plan(path: Path, cable: Cable, handle_weight_N: float, below_m: float, away_m: float, aside_m: float) -> Plan:
    """The route of one session; at the start the handle hangs `below_m` under the hand's plane, to be lifted (held.py)."""
    end = hover(path.p(1.0), handle_weight_N, cable)
    away = end + away_m * path.t_hat(1.0)
    down = away * HORIZONTAL + 0.95 * cable.rest_length_m * Z
    start = hover(path.p(0.0) - below_m * Z, handle_weight_N, cable)
    return Plan(start, (away, down, down + aside_m * path.normal(1.0)))
