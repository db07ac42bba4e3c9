"""The scene that a 3D viewer shows: path and tube once; drone, cable, handle, person and forces at every instant.

Positions are in W. A cable's colour is its tension: grey slack, from blue to red at 2.5 N, black unknown. Forces are
0.3 m per newton.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from foxglove.messages import (
    ArrowPrimitive,
    Color,
    CylinderPrimitive,
    Duration,
    LinePrimitive,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    TextPrimitive,
    Timestamp,
    Vector3,
)

from services.guiding_controller.path import Path
from services.physics import Array, Z, norm, rotate

FRAME = "world"
METRES_PER_NEWTON = 0.3
LIFETIME_S = 0.3
TUBE_RADIUS_M = 0.3  # the paper's: everyone walked inside 60 cm
_STRONG_N = 2.5
_ROTORS = 0.14 * np.array([(1, 1, 0), (1, -1, 0), (-1, 1, 0), (-1, -1, 0)])
_UNKNOWN_COLOR = "#000000"
_LEVEL_COLORS = ("#009E73", "#E69F00", "#D55E00", "#b3261e", "#b3261e", "#b3261e")


class Instant(NamedTuple):
    """What is known at one time; NaN and empty text are what is not."""

    time_ns: int
    p_R: Array
    q_WB_wxyz: Array
    p_H: Array
    f_c: Array
    u_A: Array
    head: Array
    held: bool
    level: int
    text: str


def still(path: Path, time_ns: int) -> SceneUpdate:
    """What never moves."""
    points = path.p(np.linspace(0.0, 1.0, 101))
    sides = [points + side * TUBE_RADIUS_M * path.normal(np.linspace(0.0, 1.0, 101)) for side in (-1.0, 1.0)]
    lines = [_line(points, "#333333", 0.015), *(_line(side, "#999999", 0.005) for side in sides)]
    posts = [
        CylinderPrimitive(
            pose=_pose((post.x_m, post.y_m, 0.6)),
            size=Vector3(x=2 * post.radius_m, y=2 * post.radius_m, z=1.2),
            bottom_scale=1.0,
            top_scale=1.0,
            color=color("#bbbbbb", 0.6),
        )
        for post in path.obstacles
    ]
    return SceneUpdate(
        entities=[SceneEntity(timestamp=stamp(time_ns), frame_id=FRAME, id="path", lines=lines, cylinders=posts)]
    )


def moving(now: Instant) -> SceneUpdate:
    """What is known of the rest."""
    made = [_drone(now), _hand(now), _person(now), _cable(now)]
    return SceneUpdate(entities=[entity for entity in made if entity is not None])


def _drone(now: Instant) -> SceneEntity | None:
    if not _known(now.p_R):
        return None
    rotors = [
        CylinderPrimitive(
            pose=_pose(now.p_R + rotate(now.q_WB_wxyz, arm), now.q_WB_wxyz),
            size=Vector3(x=0.18, y=0.18, z=0.02),
            bottom_scale=1.0,
            top_scale=1.0,
            color=color("#0072B2", 0.8),
        )
        for arm in _ROTORS
    ]
    arrows = [arrow] if (arrow := _arrow(now.p_R, now.u_A, "#8c8c8c")) else []
    text = TextPrimitive(
        pose=_pose(now.p_R + 0.25 * Z),
        billboard=True,
        font_size=0.08,
        color=color(_LEVEL_COLORS[min(now.level, 5)]),
        text=now.text,
    )
    return _entity("drone", now.time_ns, cylinders=rotors, arrows=arrows, texts=[text])


def _hand(now: Instant) -> SceneEntity | None:
    if not _known(now.p_H):
        return None
    arrow = _arrow(now.p_H, now.f_c, "#D55E00")
    ball = SpherePrimitive(
        pose=_pose(now.p_H), size=Vector3(x=0.09, y=0.09, z=0.09), color=color("#009E73" if now.held else "#cccccc")
    )
    return _entity("handle", now.time_ns, spheres=[ball], arrows=[arrow] if arrow else [])


def _person(now: Instant) -> SceneEntity | None:
    if not _known(now.head):
        return None
    skin = color("#c9a58b", 0.9)
    ball = SpherePrimitive(pose=_pose(now.head), size=Vector3(x=0.2, y=0.2, z=0.25), color=skin)
    height = max(float(now.head[2]) - 0.12, 0.1)
    body = CylinderPrimitive(
        pose=_pose((now.head[0], now.head[1], height / 2.0)),
        size=Vector3(x=0.35, y=0.35, z=height),
        bottom_scale=0.7,
        top_scale=1.0,
        color=color("#6b7a8f", 0.6),
    )
    shoulder = now.head - 0.3 * Z
    arm = [_line(np.array((shoulder, now.p_H)), "#c9a58b", 0.05)] if now.held and _known(now.p_H) else []
    return _entity("person", now.time_ns, spheres=[ball], cylinders=[body], lines=arm)


def _cable(now: Instant) -> SceneEntity | None:
    if not (_known(now.p_H) and _known(now.p_R)):
        return None
    code = tension_color(float(norm(now.f_c))) if _known(now.f_c) else _UNKNOWN_COLOR
    return _entity("cable", now.time_ns, lines=[_line(np.array((now.p_H, now.p_R)), code, 0.012)])


def tension_color(pull_N: float) -> str:
    """Grey for slack, else from blue to red."""
    if pull_N < 0.01:
        return "#bbbbbb"
    share = min(pull_N / _STRONG_N, 1.0)
    return f"#{round(60 + 180 * share):02x}{round(130 - 70 * share):02x}{round(200 - 160 * share):02x}"


def color(code: str, a: float = 1.0) -> Color:
    """From #rrggbb."""
    r, g, b = (int(code[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return Color(r=r, g=g, b=b, a=a)


def stamp(time_ns: int) -> Timestamp:
    """Wall-clock time as Foxglove wants it."""
    return Timestamp(time_ns // 1_000_000_000, time_ns % 1_000_000_000)


def quaternion(q_wxyz: Array) -> Quaternion:
    """Foxglove's order is x, y, z, w."""
    w, x, y, z = map(float, q_wxyz)
    return Quaternion(x=x, y=y, z=z, w=w)


def _known(v: Array) -> bool:
    return bool(np.all(np.isfinite(v)))


def _entity(name: str, time_ns: int, **parts: Sequence[object]) -> SceneEntity:
    """Gone from the picture unless it is said again: what is no longer known must not stand there."""
    lifetime = Duration(0, round(LIFETIME_S * 1e9))
    return SceneEntity(timestamp=stamp(time_ns), frame_id=FRAME, id=name, lifetime=lifetime, **parts)  # pyright: ignore[reportArgumentType]


def _pose(p: Sequence[float] | Array, q_wxyz: Array | None = None) -> Pose:
    x, y, z = map(float, p)
    turn = Quaternion(w=1.0) if q_wxyz is None else quaternion(q_wxyz)
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=turn)


def _line(points: Array, code: str, thickness_m: float) -> LinePrimitive:
    corners = [Point3(x=x, y=y, z=z) for x, y, z in points.tolist()]
    return LinePrimitive(points=corners, thickness=thickness_m, color=color(code), pose=_pose((0.0, 0.0, 0.0)))


def _arrow(tail: Array, force_N: Array, code: str) -> ArrowPrimitive | None:
    if not _known(force_N) or float(norm(force_N)) < 0.05:
        return None
    length = METRES_PER_NEWTON * float(norm(force_N))
    head = min(0.06, length / 2.0)
    return ArrowPrimitive(
        pose=_pose(tail, along(force_N)),
        shaft_length=length - head,
        shaft_diameter=0.015,
        head_length=head,
        head_diameter=0.04,
        color=color(code),
    )


def along(v: Array) -> Array:
    """The rotation (w, x, y, z) that turns the x axis into the direction of v (3,)."""
    x, y, z = (v / norm(v)).tolist()
    if x < -0.999999:
        return np.array((0.0, 0.0, 0.0, 1.0))
    q = np.array((1.0 + x, 0.0, -z, y))
    return q / np.linalg.norm(q)
