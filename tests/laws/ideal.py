"""The paper's ideal world: the robot is where the filter's reference is, the person is a mass with a damper."""

from collections.abc import Callable
from functools import cache
from pathlib import Path as File
from typing import NamedTuple, TypeAlias

import numpy as np

from services import cable
from services.guiding_controller import guiding
from services.guiding_controller.path import Path
from services.guiding_controller.path_file import read
from services.physics import Array, norm
from services.px4_bridge import admittance, tank

PATHS = File(__file__).parents[2] / "deploy" / "paths"
PLANE_Z = 1.0
CABLE = cable.Cable(rest_length_m=1.0, k_c_N_per_m=200.0, d_c_Ns_per_m=1.0)
GUIDING = guiding.Guiding(k_H_N_per_m=4.5, f_z_N=1.0, e_R_max_m=0.175, ramp_s=2.0, s_rate_max_mps=1.0, window_m=0.5)
FILTER = admittance.Admittance(
    M_A_kg=0.8,
    b_A_Ns_per_m=2.4,
    k_H_N_per_m=4.5,
    k_z_N_per_m=10.0,
    e_R_max_m=0.175,
    b_free_Ns_per_m=10.0,
    b_slack_Ns_per_m=10.0,
    slack_keep_s=1.0,
)
TANK = tank.Tank(capacity_J=8.0, fade_J=0.5)
M_H_KG, B_H_NS_PER_M = 5.0, 8.0
YES, NO = np.array(True), np.array(False)


Filter: TypeAlias = Callable[..., tuple[admittance.State, Array]]
"""`admittance.step`, or what stands in its place."""


class Walk(NamedTuple):
    t_s: Array
    p_H: Array
    p_R: Array
    s: Array
    f_c: Array
    v_H: Array
    u_A: Array


def paper_path() -> Path:
    return read(PATHS / "paper.toml", PLANE_Z)


def person(p_H: Array, v_H: Array, f_c: Array, dt: float) -> tuple[Array, Array]:
    """humanModel in the plane: f_g keeps z."""
    v = (v_H + dt * f_c / M_H_KG) / (1.0 + dt * B_H_NS_PER_M / M_H_KG) * guiding.HORIZONTAL
    return p_H + dt * v, v


def walk(path: Path, duration_s: float, dt: float = 0.005, step: Filter = admittance.step) -> Walk:
    """A guided walk from the start of the path: guidance every 10 ms, filter, person and cable every `dt`."""
    p_H, v_H = path.p(0.0), np.zeros(3)
    state = admittance.engage(p_H + np.array([0.0, 0.0, 1.0]))
    g_state = guiding.start(p_H, path)
    command = admittance.literal(np.zeros(3))
    rows: list[tuple[Array, ...]] = []
    every, u_A = round(0.01 / dt), np.zeros(3)
    for k in range(round(duration_s / dt)):
        if k % every == 0:
            x = guiding.Input(p_H, state.p, YES, YES)
            g_state, g = guiding.step(g_state, x, 0.01, path, GUIDING, CABLE)
            command = admittance.guide(g.p_R_d, g.f_d, g.scale, FILTER)
        f_c = cable.force(state.p, p_H, state.v, v_H, CABLE)
        if k % every == 0:
            rows.append((np.array(k * dt), p_H, state.p, g_state.s, f_c, v_H, u_A))
        slack = norm(state.p - p_H) < 1.0 - 0.02
        state, u_A = step(state, f_c, command, slack, dt, PLANE_Z + 1.1, FILTER)
        p_H, v_H = person(p_H, v_H, f_c, dt)
    return Walk(*(np.stack(column) for column in zip(*rows, strict=True)))


@cache
def paper_walk() -> Walk:
    return walk(paper_path(), 38.0)


@cache
def paper_path_cached() -> Path:
    """The path itself never changes; reading it costs some milliseconds."""
    return paper_path()
