"""The configuration of a deployment: a profile and the files it names, validated once, before anything starts.

A profile (deploy/profiles/*.toml) names a vehicle, a path and a person (deploy/vehicles, paths, people) and has one
section per service. The shape of each section stands beside the law that uses it; limits across sections stand here.
A launched service reads the resolved configuration from one JSON file, which is also recorded.
"""

import os
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from schemas.topics import OPERATOR, SERVICES
from services import sections
from services.cable import Cable
from services.calibration import layer
from services.calibration.result import Calibration
from services.gateway.radio import CONSOLE, Host, Radio, check_hosts
from services.guiding_controller import maneuver, path_file
from services.guiding_controller.path import Path as GuidedPath
from services.parameters import NonNegative, Positive, parameters
from services.physics import GRAVITY_MPS2
from services.profile_file import ConfigError, find, get, layered, put, read, written_in
from services.px4_bridge.admittance import check as check_virtual_mass
from services.recorder.writer import Recorder
from services.runtime.hosts import Placement
from services.tracker.bodies import check as check_source


@parameters
class System:
    """Which system this is and what runs in it."""

    name: str
    services: tuple[str, ...]
    vehicle: str
    path: str
    person: str
    seed: int
    host: str = ""
    """Of a system on two hosts, which one this is: drone, ground, or a person's console."""
    calibration: str = ""
    """What `clew calibrate` wrote: a name in deploy/calibration, or a file."""


@parameters
class World:
    """The motion-capture volume; W's origin is on its floor."""

    hand_height_m: Positive
    """Height of the paper's plane z = 0."""
    volume_min_m: tuple[float, float, float]
    volume_max_m: tuple[float, float, float]
    handle_mass_kg: NonNegative
    handle_start_m: tuple[float, float, float]
    """Where the handle lies before take-off, the cable laid out."""


class Config(BaseModel):
    """Everything a service may know."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    system: System
    world: World
    cable: Cable
    vehicle: sections.Vehicle
    tracker: sections.Tracker
    force_estimator: sections.ForceEstimator
    guiding_controller: sections.GuidingController
    px4_bridge: sections.Px4Bridge
    safety_supervisor: sections.SafetySupervisor
    simulator: sections.Simulator
    recorder: Recorder
    path: sections.PathTable
    person: sections.Person
    calibration: Calibration = Calibration()
    hosts: dict[str, Host] = Field(default_factory=dict[str, Host])
    radio: Radio | None = None
    subject: str = Field(default="", description="who walks, by the study's own code")
    condition: str = Field(default="", description="under which of the study's conditions")
    session_dir: str = Field(default="", description="where this run keeps its files")

    @model_validator(mode="after")
    def _limits_across_sections(self) -> Self:
        if self.hosts:
            check_hosts(self.hosts, self.radio, self.system.host)
        unknown = set(self.system.services) - set(SERVICES)
        _require(not unknown, "system.services", sorted(unknown), f"one of {', '.join(SERVICES)}")
        weight = self.person.human.m_H_kg * GRAVITY_MPS2
        f_z = self.guiding_controller.f_z_N
        _require(f_z < weight, "guiding_controller.f_z_N", f_z, f"below m_H g = {weight:.2f} N of {self.person.name}")
        _require(
            self.world.handle_mass_kg <= 0.05, "world.handle_mass_kg", self.world.handle_mass_kg, "at most 0.05 kg"
        )
        try:
            check_virtual_mass(self.px4_bridge.admittance.M_A_kg, self.vehicle.quadrotor.mass_kg)
        except ValueError as error:
            raise ValueError(f"px4_bridge.admittance.M_A_kg: {error}") from None
        try:
            _ = self.guided_path
        except ValueError as error:
            raise ValueError(f"path.{error}") from None
        self._inside_volume()
        check_source(self.tracker.source, self.tracker.mocap)
        tank, work = self.px4_bridge.tank, maneuver.work(self.guided_path)
        enough = tank.capacity_J >= work + tank.fade_J
        limit = f"at least {work + tank.fade_J:.2f} J: the walk takes {work:.2f} J, and the tank fades below fade_J"
        _require(enough, "px4_bridge.tank.capacity_J", tank.capacity_J, limit)
        return self

    def host_of(self, service: str) -> str:
        """Where it runs; empty in a system on one host."""
        return next((name for name, host in self.hosts.items() if service in host.services), "")

    def placement(self, here: str = "") -> Placement:
        """Who is on the other host, seen from `here` or else from this one; nobody in a system on one.

        A console's clock is the ground's (gateway/console.py), and so is that of whoever gives commands.
        """
        here = (here or self.system.host).replace(CONSOLE, "ground")
        if not here or self.radio is None:
            return Placement()
        elsewhere = tuple(name for host, each in self.hosts.items() if host != here for name in each.services)
        people = () if here == "ground" else (OPERATOR,)
        return Placement(here=here, elsewhere=elsewhere + people, delay_allowed_s=self.radio.delay_allowed_s)

    def _inside_volume(self) -> None:
        low, high = np.array(self.world.volume_min_m), np.array(self.world.volume_max_m)
        points = self.guided_path.p(np.linspace(0.0, 1.0, 101))
        outside = points[np.any((points < low) | (points > high), axis=-1)]
        if len(outside):
            x, y, z = outside[0]
            raise ValueError(f"path.waypoints_m: the path passes {x:.2f}, {y:.2f}, {z:.2f} m, outside world.volume")

    @cached_property
    def guided_path(self) -> GuidedPath:
        """The path of the hand, at the hand's height."""
        return path_file.build(dict(self.path), self.world.hand_height_m)


def _require(holds: bool, key: str, value: object, limit: str) -> None:
    if not holds:
        raise ValueError(f"{key} = {value}: must be {limit}")


# A truth that several laws need is written once; an entry of a profile for one of them wins, to study a wrong belief.
DERIVED = (
    ("px4_bridge.flight.m_R_kg", "vehicle.quadrotor.mass_kg", 1.0),
    ("px4_bridge.admittance.M_A_kg", "vehicle.quadrotor.mass_kg", 1.0),
    ("force_estimator.observer.m_R_kg", "vehicle.quadrotor.mass_kg", 1.0),
    ("px4_bridge.vehicle.max_thrust_N", "vehicle.quadrotor.rotor_thrust_max_N", 4.0),
    ("simulator.autopilot.cascade", "vehicle.cascade", 1.0),
    ("simulator.autopilot.px4", "px4_bridge.px4", 1.0),
    ("simulator.handle.mass_kg", "world.handle_mass_kg", 1.0),
    ("px4_bridge.flight.handle_weight_N", "world.handle_mass_kg", GRAVITY_MPS2),
    ("force_estimator.bias.handle_weight_N", "world.handle_mass_kg", GRAVITY_MPS2),
    ("safety_supervisor.held.handle_weight_N", "world.handle_mass_kg", GRAVITY_MPS2),
    ("px4_bridge.flight.rest_length_m", "cable.rest_length_m", 1.0),
    ("person.human.hand_height_m", "world.hand_height_m", 1.0),
    ("guiding_controller.k_H_N_per_m", "px4_bridge.admittance.k_H_N_per_m", 1.0),
    ("guiding_controller.e_R_max_m", "px4_bridge.admittance.e_R_max_m", 1.0),
)

_FILES = {"vehicle": "vehicles", "path": "paths", "person": "people"}  # sections that are files of their own

_SOURCES = {target: source for target, source, _ in DERIVED}


def _derive(data: dict[str, Any]) -> None:
    """Fill in what follows from elsewhere; what cannot be derived is left to the validation to miss."""
    for target, source, factor in DERIVED:
        value = get(data, source)
        if value is not None:
            put(data, target, value * factor if isinstance(value, (int, float)) else value, over=False)


def load(
    profile: str, *, path: str = "", person: str = "", seed: int | None = None, session_dir: str = "", px4: str = ""
) -> Config:
    """A validated configuration from a profile's name or file; `px4` is PX4's program, where PX4 is simulated with.

    Raises:
        ConfigError: with one line per fault: file, key, value, limit.
    """
    file = find("profiles", profile)
    if file.suffix == ".json":
        return _validate(file, read(file), {})
    data, written = layered(file)
    system: dict[str, Any] = data.setdefault("system", {})
    if not isinstance(system, dict):  # pyright: ignore[reportUnnecessaryIsInstance]  (a file may say anything)
        raise ConfigError(f"{file}: system = {system!r}: must be a table")
    system.update({k: v for k, v in (("path", path), ("person", person), ("seed", seed)) if v not in ("", None)})
    if hosts := data.get("hosts"):
        here = get(hosts, f"{system.get('host')}.services")  # a fault in it is told of where it was written
        named = cast("list[Any]", here) if isinstance(here, list) else []
        system["services"] = [name for name in named if isinstance(name, str)]
    files: dict[str, Path] = dict(written)
    for section, folder in _FILES.items():
        if section not in system:
            raise ConfigError(f"{file}: system.{section}: is missing")
        files[section] = find(folder, str(system[section]), f"{file}: system.{section} = ")
        data[section] = read(files[section])
    if name := system.get("calibration"):
        files["calibration"] = find("calibration", str(name), f"{file}: system.calibration = ")
        data["calibration"] = read(files["calibration"])
        try:
            files |= layer.lay_over(data, files["calibration"])
        except ValidationError as error:
            raise ConfigError("\n".join(_lines(error, files["calibration"], {}))) from None
    _derive(data)
    if px4 and get(data, "simulator.px4_sitl") is not None:
        _program(data, px4)
    return _validate(file, data | {"session_dir": session_dir}, files)


def of_recording(file: Path, data: dict[str, Any]) -> Config:
    """The configuration that `file` carries. Raises ConfigError as `load`."""
    return _validate(file, data, {})


@contextmanager
def told_in(profile: str) -> Generator[None]:
    """A fault that is found after loading, such as an address, is told with the file of the profile that says its key.

    One that begins with a file of its own stays as it is. Raises ConfigError.
    """
    try:
        yield
    except ConfigError as error:
        where = written_in(layered(find("profiles", profile)).written, _key_of(str(error)))
        raise ConfigError(f"{where}: {error}" if where else str(error)) from None


def load_vehicle(name: str) -> sections.Vehicle:
    """A vehicle alone, from its name in deploy/vehicles or its file. Raises ConfigError like `load`."""
    file = find("vehicles", name)
    try:
        return TypeAdapter(sections.Vehicle).validate_python(read(file))
    except ValidationError as error:
        raise ConfigError("\n".join(_lines(error, file, {}))) from None


def _program(data: dict[str, Any], px4: str) -> None:
    if not os.access(px4, os.X_OK) or Path(px4).is_dir():
        raise ConfigError(f"PX4's program (--px4 or PX4_BIN) = {px4}: must be a file that can be run")
    data["simulator"]["px4_sitl"]["binary"] = str(Path(px4).absolute())


def _validate(file: Path, data: dict[str, Any], files: dict[str, Path]) -> Config:
    try:
        return Config.model_validate(data)
    except ValidationError as error:
        raise ConfigError("\n".join(_lines(error, file, files))) from None


def _lines(error: ValidationError, file: Path, files: dict[str, Path]) -> Iterator[str]:
    """One line per fault, in the file where it stands; what follows from a fault is not told again."""
    faults = [(".".join(map(str, fault["loc"])), fault) for fault in error.errors()]
    places = {place for place, _ in faults}
    for place, fault in faults:
        if places & _origins(place):
            continue
        parts = [str(part) for part in fault["loc"]]
        message = fault["msg"].removeprefix("Value error, ")
        if not parts:  # a limit across sections: the message begins with its key
            yield f"{written_in(files, _key_of(message)) or file}: {message}"
            continue
        where = written_in(files, place if place in files else _SOURCES.get(place, place)) or file
        key = ".".join(parts[1:] if parts[0] in _FILES else parts)
        if source := _SOURCES.get(".".join(parts)):
            key = f"{key}, from {source}"
        shown = "" if fault["type"] in ("missing", "missing_argument") else f" = {fault['input']!r}"
        yield f"{where}: {key}{shown}: {_plain(fault['type'], message)}"


def _origins(place: str) -> set[str]:
    """Where a value was taken from, if it was derived: the key and the tables it is in."""
    found = [source + place[len(t) :] for t, source in _SOURCES.items() if f"{place}.".startswith(f"{t}.")]
    return {".".join(key.split(".")[:n]) for key in found for n in range(1, key.count(".") + 2)}


def _key_of(message: str) -> str:
    """With which a limit across sections begins."""
    return message.split(" = ")[0].split(":")[0]


def _plain(kind: str, message: str) -> str:
    if kind in ("missing", "missing_argument"):
        return "is missing"
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        return "is not a known key"
    return message.replace("Input should be", "must be")
