"""The same statistics from recorded sessions: each session is a walk."""

from collections.abc import Sequence
from pathlib import Path as File
from typing import NamedTuple

import numpy as np

from services.campaign import statistics
from services.campaign.population import Columns
from services.campaign.statistics import Result
from services.guiding_controller.path import Path
from services.physics import Array, norm
from services.recorder import reading
from services.recorder.walk import config_of, guided, motion, path_of


def read(files: Sequence[File]) -> Result:
    """The guided parts of the recordings as walks along one path; persons are told apart by the names they go by.

    Raises ValueError or OSError: the file, and what is wrong with it.
    """
    walks = [_walk(file) for file in files]
    path = walks[0].path
    for file, walk in zip(files, walks, strict=True):
        if walk.path.waypoints_m.shape != path.waypoints_m.shape or not np.allclose(
            walk.path.waypoints_m, path.waypoints_m
        ):
            raise ValueError(f"{file}: path = {walk.path.name}: must be the same as {path.name} of {files[0]}")
    names = list(dict.fromkeys(walk.person for walk in walks))
    person = np.array([names.index(walk.person) + 1.0 for walk in walks])
    trial = np.array([float(np.count_nonzero(person[: i + 1] == person[i])) for i in range(len(person))])
    measured = [walk.columns for walk in walks]
    columns = {"person": person, "trial": trial}
    columns |= {name: np.concatenate([columns[name] for columns in measured]) for name in measured[0]}
    return Result(path, columns, np.concatenate([walk.errors for walk in walks]), [walk.trace for walk in walks])


class _Walk(NamedTuple):
    """One recording's guided part."""

    path: Path
    person: str
    columns: Columns
    errors: Array
    trace: Array


def _walk(file: File) -> _Walk:
    session = reading.read(file)
    config, path, moved = config_of(session), path_of(session), motion(session)
    walking = moved.during(guided(session))
    if path is None:
        raise ValueError(f"{file}: has no configuration, so its path is not known")
    if np.count_nonzero(walking) < 2:
        raise ValueError(f"{file}: nobody was guided in it")
    t_s, p_H, p_R = moved.t_s[walking], moved.p_H[walking], moved.p_R[walking]
    rest_length_m = np.array([config["cable"]["rest_length_m"]])
    columns, errors = statistics.of_walks(t_s, p_H[None], p_R[None], path, rest_length_m)
    columns["force_max_N"] = np.array([np.max(norm(moved.f_c[walking]))])
    body = config["person"]["human"]
    columns |= {name: np.array([float(body[name])]) for name in ("m_H_kg", "b_H_Ns_per_m")}
    return _Walk(path, config["person"]["name"], columns, errors, p_H[:, :2])
