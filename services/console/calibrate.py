"""`clew calibrate`: from a recording, or from a living system, to the numbers of this vehicle and this laboratory."""

import asyncio
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic_core import from_json

from schemas.message import Message
from schemas.topics import Topic
from services.calibration import delay, handle, result, samples, thrust
from services.calibration.fit import Unfit
from services.calibration.layer import calibration_file
from services.calibration.result import Found, Result
from services.calibration.samples import Tables
from services.config import Config, ConfigError, load, of_recording
from services.console.look import with_node
from services.physics import GRAVITY_MPS2
from services.recorder.origin import revision
from services.recorder.reading import NotARecording, Session
from services.recorder.table import table_of
from services.recorder.walk import CONFIG_ATTACHMENT
from services.runtime.node import Node
from services.tracker.sources import open_source

HANDLE_LEFT_MAX_M = 0.003
DELAY_LEFT_MAX = 0.5
"""Of the rates themselves: with more, the marker body's frame is not the inertial unit's."""
DELAY_SIGMA_MAX_S = 0.003


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What the command line says; a mass of NaN is the configuration's."""

    kind: str
    profile: str
    recordings: Sequence[Path] = ()
    seconds: float = 30.0
    out: Path | None = None
    mass_kg: float = float("nan")
    hanging_kg: float = float("nan")
    added_kg: Sequence[float] = field(default_factory=list[float])


class Heard(NamedTuple):
    """One recording, or what a living system said."""

    tables: Tables
    config: Config
    name: str
    recorded_by: str


class Outcome(NamedTuple):
    """A result, what it says in words, and why it is refused; empty where it is not."""

    result: Result
    words: str
    refusal: str


def calibrate(asked: Asked) -> int:
    """Listen or read, fit, print, write. Returns 0 when it is written, 1 when it is refused, 2 for bad input."""
    try:
        if asked.added_kg and len(asked.added_kg) != len(asked.recordings):
            raise ConfigError("--added-kg: give it once for each recording, 0 for the bare vehicle")
        file = asked.out or calibration_file(asked.profile)
        heard = [_recorded(recording, asked.kind) for recording in asked.recordings] or [_listened(asked)]
    except (ConfigError, NotARecording, OSError) as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2
    try:
        outcome = _FITS[asked.kind](asked, heard)
    except Unfit as error:
        return _refused(asked.kind, str(error))
    found = outcome.result.found
    print(outcome.words)  # noqa: T201
    limit = f"{found.residual:.3g} {found.residual_unit} (at most {found.residual_max:.3g})"
    print(f"left: {limit}; condition {found.condition:.3g}; {found.seconds:.1f} s of {found.recording}")  # noqa: T201
    if found.residual > found.residual_max:
        return _refused(asked.kind, f"{limit} is left: {outcome.refusal}")
    if file is None:
        print("not written: the profile has no system.calibration; --out FILE writes it")  # noqa: T201
        return 0
    result.write(file, outcome.result)
    print(f"written to {file}")  # noqa: T201
    return 0


def _refused(kind: str, why: str) -> int:
    print(f"clew calibrate {kind}: {why}; nothing is written", file=sys.stderr)  # noqa: T201
    return 1


def _recorded(recording: Path, kind: str) -> Heard:
    file = recording / "session.mcap" if recording.is_dir() else recording
    session = Session(file)
    session.prepare(*samples.TOPICS[kind])
    tables = {topic.key: session.table(topic) for topic in samples.TOPICS[kind]}
    attached = session.attachments.get(CONFIG_ATTACHMENT)
    if attached is None:
        raise ConfigError(f"{file}: has no configuration attached: whose vehicle is it?")
    origin = session.metadata.get("clew.session", {})
    by = " ".join(filter(None, (origin.get("clew-hri", "unknown"), origin.get("git", ""))))
    return Heard(tables, of_recording(file, from_json(attached)), str(file), by)


def _listened(asked: Asked) -> Heard:
    config = load(asked.profile)
    heard: dict[str, list[Message]] = {}

    async def listen(node: Node, _bus: object) -> int:
        topics = [t for t in samples.TOPICS[asked.kind] if t not in samples.MOCAP]
        tasks = [asyncio.create_task(_keep(node, topic, heard.setdefault(topic.key, []))) for topic in topics]
        if len(topics) < len(samples.TOPICS[asked.kind]):
            tasks.append(asyncio.create_task(_watch(node, config, heard)))
        await asyncio.sleep(asked.seconds)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        return 0

    if with_node(asked.profile, listen):
        raise ConfigError(f"{asked.profile}: cannot listen to the system")
    kinds = {topic.key: topic.type for topic in samples.TOPICS[asked.kind]}
    tables = {key: _table(kinds[key], messages) for key, messages in heard.items()}
    return Heard(tables, config, f"{asked.seconds:g} s of the living system {config.system.name}", _version())


async def _keep(node: Node, topic: Topic[Message], into: list[Message]) -> None:
    async for message in node.stream(topic, depth=1024):
        into.append(message)


async def _watch(node: Node, config: Config, heard: dict[str, list[Message]]) -> None:
    """The capture system itself, as the tracker opens it."""
    async with open_source(config.tracker, node) as source:
        into = heard.setdefault(source.topic.key, [])
        async for frame in source.frames:
            into.append(frame)


def _table(kind: type[Message], messages: list[Message]) -> samples.Table:
    columns = table_of(kind, [message.model_dump_json().encode() for message in messages])
    return columns | {"t_s": columns["stamp_ns"] * 1e-9}


def _thrust(asked: Asked, heard: list[Heard]) -> Outcome:
    (only,) = _one(asked, heard)
    p = only.config.px4_bridge.vehicle
    flight, source = samples.flight(only.tables, only.config.cable.rest_length_m), samples.motors(only.tables).source
    mass_kg = only.config.px4_bridge.flight.m_R_kg if np.isnan(asked.mass_kg) else asked.mass_kg
    found = thrust.thrust(flight, mass_kg, _hanging_kg(asked, only), p.thrust_curve)
    said = result.ThrustResult(
        thrust_source=source,
        max_thrust_N=found.max_thrust_N,
        thrust_curve=found.curve,
        thrust_error=found.error,
        voltage_exponent=found.voltage_exponent,
        reference_V=found.reference_V,
        rpm_max=p.rpm_max,
        lag_s=found.lag_s,
        low_N=found.low_N,
        high_N=found.high_N,
        found=_found(
            heard, _seconds(flight), found.error, result.THRUST_ERROR_MAX, "of the thrust", found.fit.condition
        ),
    )
    curve = f"{found.curve:.3f}{', kept: thrust hardly changed' if found.kept_curve else ''}"
    words = (
        f"thrust by {source}: {found.max_thrust_N:.3f} N at full range, curve {curve}, voltage's exponent "
        f"{found.voltage_exponent:.2f}; lag {1000 * found.lag_s:.0f} ms; seen from {found.low_N:.2f} to "
        f"{found.high_N:.2f} N with m_R = {mass_kg:g} kg (the profile had {p.max_thrust_N:.3f} N, {p.thrust_curve:.3f})"
    )
    walk_N = (mass_kg + only.config.world.handle_mass_kg) * GRAVITY_MPS2 + only.config.guiding_controller.f_z_N
    if found.high_N < walk_N:
        words += (
            f"\nguiding takes {walk_N:.1f} N, more than was seen: its error there is not known; fly steps up and down"
        )
    return Outcome(said, words, "was it windy, did the load swing, did anything touch the cable?")


def _mass(asked: Asked, heard: list[Heard]) -> Outcome:
    flights = [samples.flight(each.tables, each.config.cable.rest_length_m) for each in heard]
    newtons = [samples.motors(each.tables).thrust_N for each in heard]
    added = list(asked.added_kg) or [0.0] * len(heard)
    found = thrust.mass(flights, newtons, added, _hanging_kg(asked, heard[0]))
    sigma_kg = float(found.fit.sigma[-1])
    left = found.fit.rms / (found.mass_kg * GRAVITY_MPS2)
    seconds = sum(map(_seconds, flights))
    said = result.MassResult(
        m_R_kg=found.mass_kg,
        sigma_kg=sigma_kg,
        thrust_scale=found.scale,
        found=_found(heard, seconds, left, result.THRUST_ERROR_MAX, "of the thrust", found.fit.condition),
    )
    before = heard[0].config.px4_bridge.flight.m_R_kg
    words = (
        f"mass: {found.mass_kg:.4f} kg ± {sigma_kg:.4f}, thrust {found.scale:.4f} times the model's "
        f"(the profile had {before:g} kg)"
    )
    return Outcome(said, words, "did anything touch the cable?")


def _handle(asked: Asked, heard: list[Heard]) -> Outcome:
    (only,) = _one(asked, heard)
    system = only.config.tracker.mocap
    t_s, p, q = samples.handle_poses(only.tables, system.handle.offset_m if system else (0.0, 0.0, 0.0))
    found = handle.handle(p, q)
    x, y, z = map(float, found.offset)
    said = result.HandleResult(
        offset_m=(x, y, z),
        found=_found(heard, float(np.ptp(t_s)), found.left_m, HANDLE_LEFT_MAX_M, "m from O_H", found.fit.condition),
    )
    words = f"handle: O_H is {1000 * x:.1f}, {1000 * y:.1f}, {1000 * z:.1f} mm from the markers' origin, in their frame"
    return Outcome(said, words, "did the cable's end stay where it was?")


def _delay(asked: Asked, heard: list[Heard]) -> Outcome:
    (only,) = _one(asked, heard)
    found = delay.delay(*samples.attitudes(only.tables))
    left = found.left_rad_s / found.rate_rad_s
    if found.delay_s < -DELAY_SIGMA_MAX_S:
        raise Unfit(
            f"poses are stamped {-1000 * found.delay_s:.1f} ms before they were true: the clocks of vehicle and poses differ"
        )
    said = result.DelayResult(
        delay_s=max(found.delay_s, 0.0),  # the least that PX4 has
        sigma_s=found.sigma_s,
        found=_found(heard, found.seconds, left, DELAY_LEFT_MAX, "of the body rate", found.condition),
    )
    words = (
        f"delay: poses are {1000 * found.delay_s:.1f} ms ± {1000 * found.sigma_s:.1f} older than their stamps, "
        f"by body rates of {found.rate_rad_s:.2f} rad/s"
    )
    if found.sigma_s > DELAY_SIGMA_MAX_S:
        limit = 1000 * DELAY_SIGMA_MAX_S
        raise Unfit(f"±{1000 * found.sigma_s:.1f} ms, at most ±{limit:g} ms: turn the vehicle by hand, propellers off")
    return Outcome(said, words, "is the frame of the vehicle's marker body that of the vehicle?")


_FITS = {"thrust": _thrust, "mass": _mass, "handle": _handle, "delay": _delay}


def _one(asked: Asked, heard: list[Heard]) -> list[Heard]:
    if len(heard) != 1:
        raise Unfit(f"{len(heard)} recordings: {asked.kind} takes one")
    return heard


def _hanging_kg(asked: Asked, heard: Heard) -> float:
    return heard.config.world.handle_mass_kg if np.isnan(asked.hanging_kg) else asked.hanging_kg


def _seconds(flight: thrust.Flight) -> float:
    return float(np.count_nonzero(flight.use)) * flight.dt_s


def _found(
    heard: list[Heard], seconds: float, residual: float, residual_max: float, unit: str, condition: float
) -> Found:
    return Found(
        date=datetime.now().astimezone().isoformat(timespec="seconds"),
        recording=", ".join(each.name for each in heard),
        recorded_by=", ".join(dict.fromkeys(each.recorded_by for each in heard)),
        found_by=_version(),
        seconds=seconds,
        residual=residual,
        residual_max=residual_max,
        residual_unit=unit,
        condition=condition,
    )


def _version() -> str:
    return " ".join(filter(None, (version("clew-hri"), revision())))
