"""A session in numbers, the paper's first, and whether it was as it should be."""

from collections.abc import Iterator

import numpy as np
from pydantic import BaseModel, ConfigDict

from schemas.safety import Phase
from schemas.topics import CABLE_FORCE, HEALTH, SAFETY_STATE, SETPOINT, TOPICS, TRUTH, VEHICLE_STATE
from schemas.vehicle import SetpointKind
from services.guiding_controller.path import Path
from services.physics import Array, norm
from services.recorder import metrics
from services.recorder.alarms import alarms
from services.recorder.latency import reactions
from services.recorder.reading import Interval, Session
from services.recorder.walk import NO_PHASE_2, Motion, at, config_of, elsewhere, guided, motion, path_of, valid, within

STATIONS = np.linspace(0.0, 1.0, 401)
"""s at which the paper's path error is taken."""


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class PathError(_Record):
    """|e_H(s)| over the path (E7), m."""

    mean_m: float | None
    max_m: float | None


class HandForce(_Record):
    """Largest force on the hand while it holds, N."""

    max_n: float | None


class ForceError(_Record):
    """f̂_c against the simulator's f_c in phase 2, N."""

    rms_n: float | None


class TrackingError(_Record):
    """The robot against the admittance filter's reference in phase 2, m."""

    rms_m: float | None


class Spread(_Record):
    """Of a delay, ms."""

    p50_ms: float
    p99_ms: float


class Service(_Record):
    """What a service's last heartbeat and all of them say."""

    rate_Hz: float
    missed_periods: int
    lateness_p99_ms: float
    longest_stall_ms: float


class Check(_Record):
    """One condition of a good session."""

    name: str
    value: float | None
    limit: float
    unit: str
    ok: bool

    def __str__(self) -> str:
        value = "unknown" if self.value is None else f"{self.value:.4g}"
        return f"{self.name} = {value}: must be at most {self.limit:g} {self.unit}".rstrip()


class Summary(_Record):
    """The contents of summary.json; null is what the recording cannot tell. `reasons` says why it is not ok."""

    ok: bool
    reasons: list[str]
    path_error: PathError
    end_error_m: float | None
    slack_fraction: float | None
    hand_force: HandForce
    force_error: ForceError
    tracking_error: TrackingError
    head_clearance_m: float | None
    messages: int
    messages_lost: int
    """Of this host: what the bus between its services lost."""
    messages_lost_on_radio: int = 0
    """What the other host said and a radio lost: no fault, so it is told and not judged; its effect is in the other numbers."""
    host_stalls: int
    alarms: list[str] = []
    """What limited the system in flight, in order: the time since the start, the level, and what the operator was told."""
    durations_s: dict[str, float]
    latency: dict[str, Spread]
    services: dict[str, Service]
    checks: list[Check]
    from_truth: bool
    """Whether positions and forces are the simulator's, not what the sensors saw."""

    def to_json(self) -> str:
        """As it is kept in summary.json."""
        return self.model_dump_json(indent=2) + "\n"


class Limits(_Record):
    """What a good session stays within."""

    path_error_mean_m: float = 0.035
    path_error_max_m: float = 0.065
    end_error_m: float = 0.10
    slack_fraction: float = 0.02
    hand_force_max_n: float = 2.5


GOOD = Limits()


def summarise(session: Session, limits: Limits = GOOD) -> Summary:
    """All numbers of a recording, complete or not."""
    session.prepare(*TOPICS)
    moved, path, spans = motion(session), path_of(session), guided(session)
    walking = moved.during(spans)
    error = _path_error(moved.p_H[walking], path)
    end_error = _end_error(moved, path, spans)
    slack = float(np.mean(moved.slack[walking])) if np.any(walking) else None
    force = HandForce(max_n=_max(norm(moved.f_hand[moved.held])))
    lost_on_radio = _lost_on_radio(session)
    lost = session.verdict.lost - lost_on_radio
    checks = [
        _check("path_error.mean_m", error.mean_m, limits.path_error_mean_m, "m"),
        _check("path_error.max_m", error.max_m, limits.path_error_max_m, "m"),
        _check("end_error_m", end_error, limits.end_error_m, "m"),
        _check("slack_fraction", slack, limits.slack_fraction, "of phase 2"),
        _check("hand_force.max_n", force.max_n, limits.hand_force_max_n, "N"),
        _check("messages_lost", lost, 0, ""),
    ]
    reasons = [str(check) for check in checks if not check.ok] + list(_bad_ends(session))
    return Summary(
        ok=not reasons,
        reasons=reasons,
        path_error=error,
        end_error_m=end_error,
        slack_fraction=slack,
        hand_force=force,
        force_error=ForceError(rms_n=_force_error(session, spans)),
        tracking_error=TrackingError(rms_m=_tracking_error(session, moved, spans)),
        head_clearance_m=_head_clearance(session),
        messages=session.verdict.received,
        messages_lost=lost,
        messages_lost_on_radio=lost_on_radio,
        host_stalls=int(max(session.table(SAFETY_STATE)["stalls"], default=0)),
        alarms=list(_alarms(session)),
        durations_s=_durations(session),
        latency=_latency(session),
        services=_services(session),
        checks=checks,
        from_truth=moved.from_truth,
    )


def _check(name: str, value: float | None, limit: float, unit: str) -> Check:
    return Check(name=name, value=value, limit=limit, unit=unit, ok=value is not None and value <= limit)


def _alarms(session: Session) -> Iterator[str]:
    """On the ground, before the start and after the landing, nothing is limited that matters."""
    for alarm in alarms(session.table(SAFETY_STATE)):
        if alarm.phase not in (Phase.IDLE, Phase.LANDED):
            yield f"{alarm.begin_s:.1f} s, {alarm.level.name.lower()}: {alarm.text}"


def _bad_ends(session: Session) -> Iterator[str]:
    """What is wrong with how the session, or its recording, ended."""
    if not guided(session):
        yield NO_PHASE_2
    if session.damage:
        yield f"the recording is damaged: {session.damage}"
    phases, armed = session.phases, session.table(VEHICLE_STATE)["armed"]
    if not phases or phases[-1].phase is not Phase.LANDED:
        yield f"the session ended in phase {phases[-1].phase if phases else 'unknown'}, not landed"
    if not len(armed) or armed[-1]:
        yield "the vehicle was not disarmed at the end"


def _lost_on_radio(session: Session) -> int:
    counts, far = session.verdict.topics, elsewhere(session)
    return sum(counts[topic.key].missing for topic in TOPICS if topic.publisher in far and topic.key in counts)


def _path_error(p_H: Array, path: Path | None) -> PathError:
    if path is None or len(p_H) < 2:
        return PathError(mean_m=None, max_m=None)
    error = np.abs(metrics.path_error(p_H, path, STATIONS))
    error = error[np.isfinite(error)]
    return PathError(mean_m=float(np.mean(error)) if len(error) else None, max_m=_max(error))


def _end_error(moved: Motion, path: Path | None, spans: list[Interval]) -> float | None:
    """Horizontal distance of the hand from the end of the path when phase 2 ends."""
    walking = moved.during(spans)
    if path is None or not np.any(walking):
        return None
    return float(norm((moved.p_H[walking][-1] - path.p(1.0))[:2]))


def _force_error(session: Session, spans: list[Interval]) -> float | None:
    cable, truth = valid(session.table(CABLE_FORCE)), session.table(TRUTH)
    t_s = cable["t_s"][within(cable["t_s"], spans)]
    if not len(t_s) or not len(truth["t_s"]):
        return None
    return metrics.rms(at(cable, "force_N", t_s) - at(truth, "cable_force_N", t_s))


def _tracking_error(session: Session, moved: Motion, spans: list[Interval]) -> float | None:
    sent = session.table(SETPOINT)
    chosen = within(sent["t_s"], spans) & (sent["kind"] == SetpointKind.ADMITTANCE) & sent["valid"]
    if not np.any(chosen) or not len(moved.t_s):
        return None
    robot = {"t_s": moved.t_s, "p_R": moved.p_R}
    return metrics.rms(sent["position_m"][chosen] - at(robot, "p_R", sent["t_s"][chosen]))


def _head_clearance(session: Session) -> float | None:
    """From the nearest rotor tip to the head, while the person holds the handle (G10)."""
    truth, config = session.table(TRUTH), config_of(session)
    held = truth["holding"]
    if not np.any(held) or not config:
        return None
    distance = norm(truth["robot_position_m"][held] - truth["head_position_m"][held])
    return float(np.min(distance)) - config["safety_supervisor"]["envelope"]["rotor_tip_m"]


def _durations(session: Session) -> dict[str, float]:
    total: dict[str, float] = {}
    for phase, start_s, end_s in session.phases:
        total[phase.value] = total.get(phase.value, 0.0) + end_s - start_s
    return total


def _latency(session: Session) -> dict[str, Spread]:
    return {
        stage: Spread(p50_ms=float(np.percentile(delay, 50)) * 1e3, p99_ms=float(np.percentile(delay, 99)) * 1e3)
        for stage, delay in reactions(session).items()
        if len(delay)
    }


def _services(session: Session) -> dict[str, Service]:
    beats = {name: session.table(topic) for name, topic in HEALTH.items()}
    return {
        name: Service(
            rate_Hz=float(np.median(beat["loop_rate_Hz"])),
            missed_periods=int(beat["missed_periods"][-1]),
            lateness_p99_ms=float(np.max(beat["loop_lateness_p99_ms"])),
            longest_stall_ms=float(np.max(beat["longest_stall_ms"])),
        )
        for name, beat in beats.items()
        if len(beat["t_s"])
    }


def _max(values: Array) -> float | None:
    return float(np.max(values)) if len(values) else None
