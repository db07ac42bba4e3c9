"""What the page of a report shows of one session, as plain data: decimated curves, numbers, alarms, health."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from schemas.topics import CABLE_FORCE, ENERGY, GUIDANCE, HEALTH, NOTE, SAFETY_STATE, SETPOINT, TOPICS, TRUTH
from services.guiding_controller.path import Path, project
from services.physics import Array, norm
from services.recorder import metrics
from services.recorder.alarms import alarms
from services.recorder.latency import reactions
from services.recorder.numbers import BY_KEY, NUMBERS, value
from services.recorder.reading import Session
from services.recorder.summary import STATIONS, summarise
from services.recorder.table import Table
from services.recorder.walk import Motion, at, config_of, guided, motion, path_of, valid

Data = dict[str, Any]

CURVES_HZ = 20.0
_GAP_S = 0.5


def page_data(session: Session, name: str) -> Data:
    """Everything, with time in s since the beginning of phase 2, or of the session where it has none."""
    session.prepare(*TOPICS)
    summary, moved, path = summarise(session), motion(session), path_of(session)
    spans = guided(session)
    zero_s = spans[0].start_s if spans else 0.0
    return {
        "name": name,
        "origin": dict(session.metadata.get("clew.session", {})),
        "ok": summary.ok,
        "reasons": summary.reasons,
        "fromTruth": moved.from_truth,
        "numbers": {n.key: None if (x := value(summary, n)) is None else _short(x) for n in NUMBERS},
        "limits": {check.name: check.limit * BY_KEY[check.name].factor for check in summary.checks},
        "phases": [[phase.value, _short(a - zero_s), _short(b - zero_s)] for phase, a, b in session.phases],
        "path": _path(path),
        "restLength": float(config_of(session).get("cable", {}).get("rest_length_m", 1.0)),
        "errorOfS": _error_of_s(moved, path, spans),
        "curves": _curves(session, moved, path, zero_s),
        "latency": {stage: _spread(delay) for stage, delay in reactions(session).items() if len(delay)},
        "health": {service: _health(session.table(topic), zero_s) for service, topic in HEALTH.items()},
        "alarms": list(_alarms(session.table(SAFETY_STATE), zero_s)),
        "notes": list(_notes(session.table(NOTE), zero_s)),
    }


def _path(path: Path | None) -> Data:
    if path is None:
        return {"points": [], "posts": []}
    posts = [[post.x_m, post.y_m, post.radius_m] for post in path.obstacles]
    return {"points": _rounded(path.p(np.linspace(0.0, 1.0, 201))), "posts": posts}


def _error_of_s(moved: Motion, path: Path | None, spans: list[Any]) -> list[float | None]:
    """e_H(s) in cm at every fourth station; null where the walk did not cross the normal."""
    walking = moved.during(spans)
    if path is None or np.count_nonzero(walking) < 2:
        return []
    error = 100.0 * metrics.path_error(moved.p_H[walking], path, STATIONS[::4])
    return [None if np.isnan(e) else _short(e) for e in error]


def _curves(session: Session, moved: Motion, path: Path | None, zero_s: float) -> Data:
    """On one grid of time; what is not known is missing."""
    if not len(moved.t_s):
        return {"t": []}
    t_s = np.arange(moved.t_s[0], moved.t_s[-1], 1.0 / CURVES_HZ)
    known = Table(t_s=moved.t_s, p_H=moved.p_H, p_R=moved.p_R, f_c=moved.f_c, f_hand=moved.f_hand)
    found: Data = {"t": _rounded(t_s - zero_s)}
    for name in ("p_H", "p_R", "f_c", "f_hand"):
        found[name] = _rounded(at(known, name, t_s))
    for name, topic, column in (
        ("f_hat", CABLE_FORCE, "force_N"),
        ("f_d", GUIDANCE, "f_d_N"),
        ("p_H_d", GUIDANCE, "p_H_d_m"),
        ("s", GUIDANCE, "s"),
        ("sent", SETPOINT, "position_m"),
        ("u_A", SETPOINT, "u_A_N"),
        ("age", SETPOINT, "age_s"),
        ("head", TRUTH, "head_position_m"),
        ("stored", ENERGY, "stored_J"),
        ("guidance", ENERGY, "guidance_J"),
        ("dissipated", ENERGY, "dissipated_J"),
        ("tank", ENERGY, "tank_J"),
    ):
        table = valid(session.table(topic))
        if len(table["t_s"]):
            found[name] = _with_gaps(table, column, t_s)
    if path is not None:
        nearest = project(moved.p_H, path)
        error = Table(t_s=moved.t_s, e=100.0 * norm((moved.p_H - path.p(nearest))[:, :2]))
        found["e_H"] = _rounded(at(error, "e", t_s))
    states = session.table(SAFETY_STATE)
    found["level"] = [int(v) for v in _last(states, "level", t_s)]
    found["held"] = [int(v) for v in moved.held[np.maximum(np.searchsorted(moved.t_s, t_s, side="right") - 1, 0)]]
    return found


def _with_gaps(table: Table, column: str, t_s: Array) -> list[Any]:
    """Null where nothing was said for half a second."""
    values = _rounded(at(table, column, t_s))
    own = table["t_s"]
    after = np.clip(np.searchsorted(own, t_s), 0, len(own) - 1)
    before = np.maximum(after - 1, 0)
    silent = (np.minimum(np.abs(own[after] - t_s), np.abs(own[before] - t_s))) > _GAP_S
    return [None if lost else value for value, lost in zip(values, silent, strict=True)]


def _last(table: Table, column: str, t_s: Array) -> Array:
    if not len(table["t_s"]):
        return np.zeros(len(t_s))
    return table[column][np.maximum(np.searchsorted(table["t_s"], t_s, side="right") - 1, 0)]


def _spread(delay_s: Array) -> Data:
    ms = delay_s * 1e3
    top = float(np.percentile(ms, 99.5))
    counts, edges = np.histogram(ms, bins=40, range=(0.0, max(top, 1e-3)))
    p50, p90, p99 = (_short(x) for x in np.percentile(ms, (50, 90, 99)))
    return {
        "p50": p50,
        "p90": p90,
        "p99": p99,
        "max": _short(ms.max()),
        "counts": counts.tolist(),
        "top": _short(edges[-1]),
    }


def _health(beats: Table, zero_s: float) -> Data:
    missed = np.diff(beats["missed_periods"], prepend=0)
    return {
        "t": _rounded(beats["t_s"] - zero_s),
        "late": _rounded(beats["loop_lateness_p99_ms"]),
        "missed": [int(n) for n in np.maximum(missed, 0)],
        "cpu": _rounded(100.0 * beats["cpu_fraction"]),
        "rejected": [sum(row.values()) for row in beats["rejected"]],
        "status": beats["status"].tolist()[-1:],
    }


def _alarms(states: Table, zero_s: float) -> Iterator[Data]:
    """Each stay in a set of reasons at a level above OK."""
    for alarm in alarms(states):
        yield {
            "from": _short(alarm.begin_s - zero_s),
            "to": _short(alarm.end_s - zero_s),
            "level": alarm.level.name.lower(),
            "phase": str(alarm.phase),
            "text": alarm.text,
        }


def _notes(notes: Table, zero_s: float) -> Iterator[Data]:
    for t_s, operator, text in zip(notes["t_s"], notes["operator"], notes["text"], strict=True):
        yield {"t": _short(t_s - zero_s), "operator": operator, "text": text}


def _short(x: float) -> float:
    return round(float(x), 4)


def _rounded(values: Array) -> list[Any]:
    return np.round(np.asarray(values, np.float64), 4).tolist()
