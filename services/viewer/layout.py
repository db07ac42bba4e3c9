"""Layouts made from the table of topics, for Foxglove and for Lichtblick: the scene, the paper's curves, the log, the states."""

import json
from typing import Any

import foxglove.layouts as fl

from schemas.topics import CABLE_FORCE, GUIDANCE, HANDLE_STATE, SAFETY_STATE, SETPOINT, VEHICLE_STATE, Topic
from services.recorder.writer import channel_name
from services.viewer.pictures import LOG, PLACE, SCENE, TRANSFORMS
from services.viewer.scene import FRAME

CURVES: dict[str, tuple[tuple[Topic[Any], str], ...]] = {
    "path error (m)": ((GUIDANCE, "path_error_m"),),
    "hand (m)": ((HANDLE_STATE, "position_m.{}"),),
    "robot (m)": ((VEHICLE_STATE, "position_m.{}"),),
    "cable force (N)": ((CABLE_FORCE, "force_N.{}"),),
    "u_A (N)": ((SETPOINT, "u_A_N.{}"),),
    "s, level": ((GUIDANCE, "s"), (SAFETY_STATE, "level")),
}

CAMERA = {
    "perspective": True,
    "distance": 7.0,
    "phi": 60.0,
    "thetaOffset": 45.0,
    "target": [0.0, 0.0, 0.0],
    "targetOffset": [0.0, 0.0, 0.8],
    "targetOrientation": [0.0, 0.0, 0.0, 1.0],
    "fovy": 45.0,
    "near": 0.05,
    "far": 500.0,
}
"""Over the whole of the paper's path."""


def paths(curves: tuple[tuple[Topic[Any], str], ...]) -> dict[str, str]:
    """What a plot shows, in the viewers' notation, and what the legend calls it; a vector is three lines."""
    named: dict[str, str] = {}
    for topic, field in curves:
        path = f"{channel_name(topic.key)}.{field}"
        named |= {path.format(axis): axis for axis in "xyz"} if "{}" in field else {path: field}
    return named


def foxglove() -> str:
    """A layout file for Foxglove."""
    plots = [
        fl.StackItem(
            size=0.33,
            panel=fl.PlotPanel(
                title=title,
                config=fl.PlotConfig(
                    paths=[fl.PlotSeries(value=path, label=name, enabled=True) for path, name in paths(curves).items()]
                ),
            ),
        )
        for title, curves in CURVES.items()
    ]
    scene = fl.ThreeDeePanel(
        config=fl.ThreeDeeConfig(
            follow_tf=FRAME,
            topics={topic: fl.BaseRendererSceneUpdateTopicSettings(visible=True) for topic in (SCENE, PLACE)},
        )
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
            "cameraState": CAMERA,
            "scene": {"transforms": {"showLabel": False, "lineWidth": 0, "enablePreloading": True}},
            "topics": {topic: {"visible": True} for topic in (SCENE, PLACE, TRANSFORMS)},
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
    series = [
        {"value": path, "label": name, "enabled": True, "timestampMethod": "receiveTime"}
        for path, name in paths(curves).items()
    ]
    beside = {"showLegend": len(series) > 1, "legendDisplay": "left", "sidebarDimension": 110}
    return {"lichtblickPanelTitle": title, "paths": series, "isSynced": True, "xAxisVal": "timestamp", **beside}


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
