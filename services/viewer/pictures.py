"""What is said on the bus, as channels of a viewer: every topic as it is, and a scene, transforms and a log beside them."""

from typing import TypeVar

import numpy as np
from foxglove import Channel, Context
from foxglove.channels import FrameTransformsChannel, LogChannel, SceneUpdateChannel
from foxglove.messages import FrameTransform, FrameTransforms, Log, LogLevel, Vector3
from pydantic import ValidationError

from schemas.message import Message
from schemas.safety import Level, SafetyState
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
    Topic,
)
from services.guiding_controller.path import Path
from services.recorder.schema import json_schema
from services.recorder.writer import channel_name
from services.viewer import scene
from services.viewer.scene import FRAME, Instant, quaternion, stamp

M = TypeVar("M", bound=Message)

SCENE, PLACE, TRANSFORMS, LOG = "/pictures/scene", "/pictures/place", "/tf", "/log"
"""What moves and what never does are two topics: after a jump in time a viewer has the newest message of each."""
SCENE_HZ = 20.0
STILL_s = 1.0
"""The place is shown anew as often, for viewers that come later."""
FRESH_S = 0.5
"""What was said longer ago is not drawn: a dead service's drone must not stand in the air."""
SILENT = "the supervisor is silent"

_LOG_LEVELS = {Level.OK: LogLevel.Info, Level.WARN: LogLevel.Warning, Level.EASE: LogLevel.Warning}
_UNKNOWN = np.full(3, np.nan)
_LEVEL = np.array((1.0, 0.0, 0.0, 0.0))


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
        self._place = SceneUpdateChannel(PLACE, context=context)
        self._transforms = FrameTransformsChannel(TRANSFORMS, context=context)
        self._log = LogChannel(LOG, context=context)
        self._newest: dict[str, tuple[int, bytes]] = {}
        self._told: tuple[object, ...] = ()
        self._scene_due_ns = self._still_due_ns = 0

    def take(self, key: str, payload: bytes, time_ns: int) -> None:
        """One message, `time_ns` of wall-clock time; times may not fall."""
        if key not in self._raw:
            return
        self._raw[key].log(payload, log_time=time_ns)
        self._newest[key] = time_ns, payload
        if key == SAFETY_STATE.key and (state := _read(SAFETY_STATE, payload)):
            self._tell_safety(state, time_ns)
        elif key == NOTE.key and (note := _read(NOTE, payload)):
            self._say(LogLevel.Info, f"note of {note.operator}: {note.text}", "operator", time_ns)
        self.tick(time_ns)

    def tick(self, time_ns: int) -> None:
        """Draw the scene if it is time to; where nothing may be said any more, somebody must go on to call this."""
        if time_ns >= self._scene_due_ns:
            self._scene_due_ns = time_ns + round(1e9 / SCENE_HZ)
            self._show(time_ns)

    def _show(self, time_ns: int) -> None:
        if self._path is not None and time_ns >= self._still_due_ns:
            self._still_due_ns = time_ns + round(STILL_s * 1e9)
            self._place.log(scene.still(self._path, time_ns), log_time=time_ns)
        now = self._instant(time_ns)
        self._scene.log(scene.moving(now), log_time=time_ns)
        self._transforms.log(_transforms(now), log_time=time_ns)

    def _instant(self, time_ns: int) -> Instant:
        safety, truth = self._believed(SAFETY_STATE, time_ns), self._believed(TRUTH, time_ns)
        robot = self._believed(VEHICLE_STATE, time_ns) or self._believed(ROBOT_POSE, time_ns)
        handle, cable = self._believed(HANDLE_STATE, time_ns), self._believed(CABLE_FORCE, time_ns)
        setpoint = self._believed(SETPOINT, time_ns)
        return Instant(
            time_ns,
            p_R=robot.position_m.array() if robot else _UNKNOWN,
            q_WB_wxyz=robot.q_WB_wxyz.array() if robot else _LEVEL,
            p_H=handle.position_m.array() if handle else _UNKNOWN,
            f_c=cable.force_N.array() if cable else _UNKNOWN,
            u_A=setpoint.u_A_N.array() if setpoint else _UNKNOWN,
            head=truth.head_position_m.array() if truth else _UNKNOWN,
            held=bool(safety and safety.held),
            level=safety.level if safety else Level.HOLD,
            text=safety.phase.value if safety else SILENT,
        )

    def _believed(self, topic: Topic[M], time_ns: int) -> M | None:
        """The newest message of a topic, if it is fresh and calls itself valid."""
        said_ns, payload = self._newest.get(topic.key, (0, b""))
        message = _read(topic, payload) if payload and time_ns - said_ns <= FRESH_S * 1e9 else None
        return message if message and message.valid else None

    def _tell_safety(self, state: SafetyState, time_ns: int) -> None:
        told = (state.phase, state.level, state.reasons)
        if told != self._told:
            self._told = told
            level = _LOG_LEVELS.get(state.level, LogLevel.Error)
            text = ": ".join(filter(None, (f"{state.phase}, {state.permit}", "; ".join(state.reasons))))
            self._say(level, text, "safety_supervisor", time_ns)

    def _say(self, level: LogLevel, text: str, name: str, time_ns: int) -> None:
        self._log.log(Log(timestamp=stamp(time_ns), level=level, message=text, name=name), log_time=time_ns)


def _read(topic: Topic[M], payload: bytes) -> M | None:
    """None for what is not of the topic's type, as in a recording from before a field was there."""
    try:
        return topic.type.model_validate_json(payload)
    except ValidationError:
        return None


def _transforms(now: Instant) -> FrameTransforms:
    """Robot and handle in W, as far as they are known, and the floor, so that there is W from the beginning."""
    return FrameTransforms(
        transforms=[
            FrameTransform(
                timestamp=stamp(now.time_ns),
                parent_frame_id=FRAME,
                child_frame_id=name,
                translation=Vector3(x=float(p[0]), y=float(p[1]), z=float(p[2])),
                rotation=quaternion(q),
            )
            for name, p, q in (
                ("floor", np.zeros(3), _LEVEL),
                ("robot", now.p_R, now.q_WB_wxyz),
                ("handle", now.p_H, _LEVEL),
            )
            if np.all(np.isfinite(p))
        ]
    )
