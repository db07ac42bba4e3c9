"""Layouts made from the table of topics, for Foxglove and for Lichtblick: the scene, the paper's curves, the log, the states."""

import json
from typing import Any

import foxglove.layouts as fl

from schemas.topics import CABLE_FORCE, GUIDANCE, HANDLE_STATE, SAFETY_STATE, SETPOINT, VEHICLE_STATE, Topic
from services.recorder.writer import channel_name
from services.viewer.pictures import LOG, SCENE, TRANSFORMS
from services.viewer.scene import FRAME

CURVES: dict[str, tuple[tuple[Topic[Any], str], ...]] = {
    "path error (m)": ((GUIDANCE, "path_error_m"),),
    "hand (m)": ((HANDLE_STATE, "position_m.{}"),),
    "robot (m)": ((VEHICLE_STATE, "position_m.{}"),),
    "cable force (N)": ((CABLE_FORCE, "force_N.{}"),),
    "u_A (N)": ((SETPOINT, "u_A_N.{}"),),
    "s, level": ((GUIDANCE, "s"), (SAFETY_STATE, "level")),
}


def paths(curves: tuple[tuple[Topic[Any], str], ...]) -> list[str]:
    """What a plot shows, in the viewers' notation; a vector is three lines."""
    each = [(f"{channel_name(topic.key)}.{field}", field) for topic, field in curves]
    return [path.format(axis) for path, field in each for axis in ("xyz" if "{}" in field else " ")]


def foxglove() -> str:
    """A layout file for Foxglove."""
    plots = [
        fl.StackItem(
            size=0.33,
            panel=fl.PlotPanel(
                title=title,
                config=fl.PlotConfig(paths=[fl.PlotSeries(value=path, enabled=True) for path in paths(curves)]),
            ),
        )
        for title, curves in CURVES.items()
    ]
    scene = fl.ThreeDeePanel(
        config=fl.ThreeDeeConfig(follow_tf=FRAME, topics={SCENE: fl.BaseRendererSceneUpdateTopicSettings(visible=True)})
    )
    left = fl.SplitContainer(
        direction="column",
        items=[fl.SplitItem(proportion=3, content=scene), fl.SplitItem(proportion=1, content=fl.LogPanel())],
    )
    return fl.Layout(
        content=fl.SplitContainer(
            direction="row",
            items=[
                fl.SplitItem(proportion=3, content=left),
                fl.SplitItem(proportion=2, content=fl.StackContainer(panels=plots)),
            ],
        )
    ).to_json()


def lichtblick() -> str:
    """A layout file for Lichtblick, in the form of Foxglove Studio 1.x from which it descends."""
    plots = {f"Plot!{n}": _plot(title, curves) for n, (title, curves) in enumerate(CURVES.items())}
    panels: dict[str, Any] = {
        "3D!scene": {
            "followTf": FRAME,
            "followMode": "follow-none",
            "topics": {SCENE: {"visible": True}, TRANSFORMS: {"visible": True}},
            "layers": {
                "grid": {"layerId": "foxglove.Grid", "visible": True, "frameLocked": True, "size": 8, "divisions": 8}
            },
        },
        "RosOut!log": {"topicToRender": LOG, "minLogLevel": 1, "searchTerms": []},
        **plots,
    }
    left = {"first": "3D!scene", "second": "RosOut!log", "direction": "column", "splitPercentage": 75}
    tree = {"first": left, "second": _column(list(plots)), "direction": "row", "splitPercentage": 60}
    whole = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": tree,
    }
    return json.dumps(whole, indent=1)


def _plot(title: str, curves: tuple[tuple[Topic[Any], str], ...]) -> dict[str, Any]:
    series = [{"value": path, "enabled": True, "timestampMethod": "receiveTime"} for path in paths(curves)]
    return {"title": title, "paths": series, "showLegend": True, "isSynced": True, "xAxisVal": "timestamp"}


def _column(names: list[str]) -> Any:
    """One above the other, all of the same height."""
    if len(names) == 1:
        return names[0]
    return {
        "first": names[0],
        "second": _column(names[1:]),
        "direction": "column",
        "splitPercentage": round(100 / len(names), 1),
    }
