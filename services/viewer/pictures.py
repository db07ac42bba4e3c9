"""What is said on the bus, as channels of a viewer: every topic as it is, and a scene, transforms and a log beside them."""

from typing import Any

import numpy as np
from foxglove import Channel, Context
from foxglove.channels import FrameTransformsChannel, LogChannel, SceneUpdateChannel
from foxglove.messages import FrameTransform, FrameTransforms, Log, LogLevel, Vector3
from pydantic_core import from_json

from schemas.safety import Level
from schemas.topics import (
    CABLE_FORCE,
    HANDLE_STATE,
    NOTE,
    ROBOT_POSE,
    SAFETY_STATE,
    SETPOINT,
    TOPICS,
    TRUTH,
    VEHICLE_STATE,
)
from services.guiding_controller.path import Path
from services.physics import Array
from services.recorder.schema import json_schema
from services.recorder.writer import channel_name
from services.viewer import scene
from services.viewer.scene import FRAME, Instant, quaternion, stamp

SCENE, TRANSFORMS, LOG = "/pictures/scene", "/tf", "/log"
SCENE_HZ = 20.0
STILL_s = 1.0
"""The path is shown anew as often, for viewers that come later."""

_LOG_LEVELS = {Level.OK: LogLevel.Info, Level.WARN: LogLevel.Warning, Level.EASE: LogLevel.Warning}
_UNKNOWN = np.full(3, np.nan)


class Pictures:
    """Channels in a Foxglove context; whoever listens there, a file or viewers, gets what `take` is given."""

    def __init__(self, context: Context, path: Path | None) -> None:
        self._path = path
        self._raw = {
            topic.key: Channel(
                channel_name(topic.key),
                schema=json_schema(topic.type) | {"title": topic.type.__name__},
                context=context,
                metadata={"key": topic.key},
            )
            for topic in TOPICS
        }
        self._scene = SceneUpdateChannel(SCENE, context=context)
        self._transforms = FrameTransformsChannel(TRANSFORMS, context=context)
        self._log = LogChannel(LOG, context=context)
        self._newest: dict[str, bytes] = {}
        self._told = ("", 0, [""])
        self._scene_due_ns = self._still_due_ns = 0

    def take(self, key: str, payload: bytes, time_ns: int) -> None:
        """One message, `time_ns` of wall-clock time; times may not fall."""
        if key not in self._raw:
            return
        self._raw[key].log(payload, log_time=time_ns)
        self._newest[key] = payload
        if key == SAFETY_STATE.key:
            self._tell_safety(from_json(payload), time_ns)
        elif key == NOTE.key:
            note = from_json(payload)
            self._say(LogLevel.Info, f"note of {note['operator']}: {note['text']}", "operator", time_ns)
        if time_ns >= self._scene_due_ns:
            self._scene_due_ns = time_ns + round(1e9 / SCENE_HZ)
            self._show(time_ns)

    def _show(self, time_ns: int) -> None:
        if self._path is not None and time_ns >= self._still_due_ns:
            self._still_due_ns = time_ns + round(STILL_s * 1e9)
            self._scene.log(scene.still(self._path, time_ns), log_time=time_ns)
        now = self._instant(time_ns)
        self._scene.log(scene.moving(now), log_time=time_ns)
        self._transforms.log(_transforms(now), log_time=time_ns)

    def _instant(self, time_ns: int) -> Instant:
        said = {key: from_json(self._newest[key]) for key in _SHOWN if key in self._newest}
        truth, safety = said.get(TRUTH.key), said.get(SAFETY_STATE.key, {})
        robot = said.get(VEHICLE_STATE.key) or said.get(ROBOT_POSE.key)
        handle = said.get(HANDLE_STATE.key)
        seen = handle is not None and handle["valid"]
        return Instant(
            time_ns,
            p_R=_vector(robot, "position_m"),
            q_WB_wxyz=_quaternion(robot),
            p_H=_vector(handle if seen else None, "position_m"),
            f_c=_vector(said.get(CABLE_FORCE.key), "force_N"),
            u_A=_vector(said.get(SETPOINT.key), "u_A_N"),
            head=_vector(truth, "head_position_m"),
            held=bool(safety.get("held", False)),
            level=int(safety.get("level", 0)),
            text=str(safety.get("phase", "")),
        )

    def _tell_safety(self, state: dict[str, Any], time_ns: int) -> None:
        told = (state["phase"], state["level"], state["reasons"])
        if told != self._told:
            self._told = told
            level = _LOG_LEVELS.get(Level(state["level"]), LogLevel.Error)
            why = "; ".join(state["reasons"])
            self._say(
                level, f"{state['phase']}, {state['permit']}{': ' if why else ''}{why}", "safety_supervisor", time_ns
            )

    def _say(self, level: LogLevel, text: str, name: str, time_ns: int) -> None:
        self._log.log(Log(timestamp=stamp(time_ns), level=level, message=text, name=name), log_time=time_ns)


_SHOWN = tuple(
    topic.key for topic in (TRUTH, SAFETY_STATE, VEHICLE_STATE, ROBOT_POSE, HANDLE_STATE, CABLE_FORCE, SETPOINT)
)


def _vector(message: dict[str, Any] | None, name: str) -> Array:
    return _UNKNOWN if message is None else np.array([message[name][axis] for axis in "xyz"])


def _quaternion(message: dict[str, Any] | None) -> Array:
    return np.array([message["q_WB_wxyz"][axis] for axis in "wxyz"]) if message else np.array((1.0, 0.0, 0.0, 0.0))


def _transforms(now: Instant) -> FrameTransforms:
    """Robot and handle in W, as far as they are known."""
    level = np.array((1.0, 0.0, 0.0, 0.0))
    return FrameTransforms(
        transforms=[
            FrameTransform(
                timestamp=stamp(now.time_ns),
                parent_frame_id=FRAME,
                child_frame_id=name,
                translation=Vector3(x=float(p[0]), y=float(p[1]), z=float(p[2])),
                rotation=quaternion(q),
            )
            for name, p, q in (("robot", now.p_R, now.q_WB_wxyz), ("handle", now.p_H, level))
            if np.all(np.isfinite(p))
        ]
    )
