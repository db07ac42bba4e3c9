"""Whatever is wrong in whichever file: it is refused, in lines that name file and key; and no command begins anything."""

import copy
import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from services.config import DERIVED, ConfigError, load
from services.console.cli import app
from services.profile_file import deploy_folder

KINDS = {"profiles": "demo", "vehicles": "light", "people": "lets_go"}
FILES = {
    folder: tomllib.loads((deploy_folder() / folder / f"{name}.toml").read_text()) for folder, name in KINDS.items()
}
WRONG = ({"zz": 1}, [1, "a"], float("nan"))
OPTIONAL = (
    {target for target, _, _ in DERIVED}
    | {"behaviour", "cable.d_c_Ns_per_m"}
    | {f"recorder.{key}" for key in ("rotate_bytes", "rotate_s", "free_min_bytes")}
)
Key = tuple[str, ...]


def keys(table: dict[str, Any], above: Key = ()) -> Iterator[Key]:
    """Of every value and of every table."""
    for key, value in table.items():
        yield (*above, key)
        if isinstance(value, dict):
            yield from keys(value, (*above, key))


def changed(table: dict[str, Any], key: Key, value: object = None) -> dict[str, Any]:
    """With another value, or without the key."""
    table = copy.deepcopy(table)
    *parents, last = key
    inner = table
    for parent in parents:
        inner = inner[parent]
    if value is None:
        del inner[last]
    else:
        inner[last] = value
    return table


def toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k} = {toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return repr(value) if isinstance(value, float) else json.dumps(value)


def written(file: Path, table: dict[str, Any]) -> Path:
    file.write_text("\n".join(f"{key} = {toml(value)}" for key, value in table.items()))
    return file


def refused(folder: Path, kind: str, table: dict[str, Any]) -> tuple[Path, str]:
    """The changed file and what is said about it."""
    file = written(folder / "changed.toml", table)
    profile = file
    if kind != "profiles":
        named = {"vehicles": "vehicle", "people": "person"}[kind]
        profile = written(folder / "profile.toml", changed(FILES["profiles"], ("system", named), str(file)))
    with pytest.raises(ConfigError) as why:
        load(str(profile))
    return file, str(why.value)


@pytest.mark.parametrize("kind", FILES)
def test_a_wrong_type_anywhere_is_refused_with_file_and_key(tmp_path: Path, kind: str) -> None:
    """No key is unchecked, none is a traceback; each kind of nonsense in its turn."""
    for n, key in enumerate(keys(FILES[kind])):
        value = WRONG[n % len(WRONG)] if key not in {("system",), ("px4_bridge", "px4")} else 3
        file, why = refused(tmp_path, kind, changed(FILES[kind], key, value))
        assert any(str(file) in line and key[-1] in line for line in why.splitlines()), f"{key} = {value}: {why}"


@pytest.mark.parametrize("kind", FILES)
def test_a_missing_key_anywhere_is_refused_with_file_and_key(tmp_path: Path, kind: str) -> None:
    """One line; for a missing table one for it or for each key in it."""
    for key in keys(FILES[kind]):
        if ".".join(key) in OPTIONAL or key[:2] == ("px4_bridge", "px4"):
            continue
        file, why = refused(tmp_path, kind, changed(FILES[kind], key))
        lines = why.splitlines()
        assert all(re.fullmatch(rf"{file}: .*\b{key[-1]}\b.*: is missing", line) for line in lines), f"{key}: {why}"
        assert len(lines) == 1 or isinstance(at(FILES[kind], key), dict), why


@pytest.mark.parametrize("kind", FILES)
def test_an_unknown_key_in_any_table_is_refused_with_file_and_key(tmp_path: Path, kind: str) -> None:
    tables = [(), *(key for key in keys(FILES[kind]) if isinstance(at(FILES[kind], key), dict))]
    for key in tables:
        if key == ("px4_bridge", "px4"):
            continue  # the autopilot's own names
        file, why = refused(tmp_path, kind, changed(FILES[kind], (*key, "colour"), 3))
        (line,) = why.splitlines()
        assert str(file) in line
        assert line.endswith(f"{'.'.join((*key, 'colour'))} = 3: is not a known key")


def at(table: dict[str, Any], key: Key) -> Any:
    for part in key:
        table = table[part]
    return table


@pytest.mark.parametrize("section", ["vehicle", "path", "person"])
def test_an_unknown_file_is_named_with_who_asked_for_it(tmp_path: Path, section: str) -> None:
    file, why = refused(tmp_path, "profiles", changed(FILES["profiles"], ("system", section), "nonsense"))
    (line,) = why.splitlines()
    assert line.startswith(f"{file}: system.{section} = nonsense: ")


@pytest.mark.parametrize(
    ("target", "value"),
    [
        ("force_estimator.observer.m_R_kg", 0.9),
        ("px4_bridge.admittance.M_A_kg", 1.1),
        ("px4_bridge.flight.handle_weight_N", 0.25),
        ("safety_supervisor.held.handle_weight_N", 0.2),
        ("px4_bridge.flight.rest_length_m", 0.9),
    ],
)
def test_what_a_profile_says_wins_over_what_follows_from_elsewhere(tmp_path: Path, target: str, value: float) -> None:
    """And only there: the other places still follow."""
    *parents, last = target.split(".")
    plain, table = load("demo").model_dump(), FILES["profiles"]
    told = load(str(written(tmp_path / "p.toml", changed(table, (*parents, last), value)))).model_dump()
    assert at(told, (*parents, last)) == value != at(plain, (*parents, last))
    assert changed(told, (*parents, last)) == changed(plain, (*parents, last))


@pytest.mark.parametrize("target", [target for target, _, factor in DERIVED if factor == 1.0])
def test_a_truth_is_written_once(target: str) -> None:
    source = next(source for name, source, _ in DERIVED if name == target)
    config = load("demo").model_dump()
    assert at(config, tuple(target.split("."))) == at(config, tuple(source.split(".")))


@pytest.mark.parametrize(
    "command",
    [
        ["demo", "--no-live", "--profile"],
        ["up"],
        ["run", "tracker", "--profile"],
        ["echo", "handle/state", "--profile"],
        ["hz", "--profile"],
        ["status", "--profile"],
    ],
    ids=lambda command: command[0],
)
def test_every_command_ends_with_2_and_begins_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: list[str]
) -> None:
    file = written(tmp_path / "p.toml", changed(FILES["profiles"], ("guiding_controller", "f_z_N"), 60.0))
    monkeypatch.chdir(tmp_path)
    ended = CliRunner().invoke(app, [*command, str(file)])
    assert ended.exit_code == 2
    (line,) = ended.stderr.splitlines()
    assert line.startswith(f"{file}: guiding_controller.f_z_N = 60.0: must be below")
    assert ended.stdout == ""
    assert sorted(f.name for f in tmp_path.iterdir()) == ["p.toml"]


def test_an_unknown_service_is_named_with_those_that_exist(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    ended = CliRunner().invoke(app, ["run", "trucker"])
    assert ended.exit_code == 2
    assert "trucker" in ended.stderr
    assert "tracker" in ended.stderr
    assert list(tmp_path.iterdir()) == []
