"""Files of a deployment: where they are, how they are read, and profiles that build on another.

A profile that begins with `base = "demo"` is that profile with what it says itself laid over it, table by table. Which file
said what is remembered, so that a fault is told where it stands.
"""

import json
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, cast


class ConfigError(Exception):
    """A profile that cannot be used; `str()` is one line per fault: file, key, value and limit."""


class Layered(NamedTuple):
    """A profile with its bases under it; `written` names the file of each key, dotted."""

    data: dict[str, Any]
    written: dict[str, Path]


def deploy_folder() -> Path:
    """Where profiles, vehicles, paths and people are: inside the installed package, or in the checkout."""
    packaged = Path(__file__).parent / "_deploy"
    return packaged if packaged.is_dir() else Path(__file__).parent.parent / "deploy"


def find(folder: str, name: str, asked_by: str = "") -> Path:
    """A file by its path, or by its name in a folder of deploy/. Raises ConfigError."""
    for candidate in (Path(name), deploy_folder() / folder / f"{name}.toml"):
        if candidate.is_file():
            return candidate
    known = sorted(f.stem for f in (deploy_folder() / folder).glob("*.toml"))
    raise ConfigError(f"{asked_by}{name}: no such file, and not one of {', '.join(known)} in {folder}/")


def read(file: Path) -> dict[str, Any]:
    """TOML, or JSON by its suffix. Raises ConfigError."""
    try:
        if file.suffix == ".json":
            return json.loads(file.read_text())
        return tomllib.loads(file.read_text())
    except (tomllib.TOMLDecodeError, ValueError) as error:
        raise ConfigError(f"{file}: {error}") from None


def layered(file: Path, above: tuple[Path, ...] = ()) -> Layered:
    """The profile in `file` over its bases; `above` are those that build on it. Raises ConfigError."""
    data = read(file)
    base = data.pop("base", None)
    under = Layered({}, {})
    if base is not None:
        if not isinstance(base, str):
            raise ConfigError(f"{file}: base = {base!r}: must be the name of a profile, or a file")
        below = find("profiles", base, f"{file}: base = ")
        if below.resolve() in {one.resolve() for one in (file, *above)}:
            raise ConfigError(f"{file}: base = {base}: builds on itself")
        under = layered(below, (file, *above))
    return Layered(_over(under.data, data), under.written | dict.fromkeys(_keys(data), file))


def get(data: Any, key: str) -> Any:
    """What stands under a dotted key; None where nothing does."""
    for part in key.split("."):
        data = cast("dict[str, Any]", data).get(part) if isinstance(data, dict) else None
    return data


def put(data: Any, key: str, value: Any, *, over: bool) -> None:
    """Write it under a dotted key, unless something stands there that it is not to go over."""
    *parents, last = key.split(".")
    for part in parents:
        data = cast("dict[str, Any]", data).setdefault(part, {}) if isinstance(data, dict) else None
    if isinstance(data, dict) and (over or last not in data):
        data[last] = value


def written_in(written: Mapping[str, Path], key: str) -> Path | None:
    """The file that says `key`, or the innermost table around it that any file has."""
    parts = key.split(".")
    tables = (".".join(parts[:n]) for n in range(len(parts), 0, -1))
    return next((written[table] for table in tables if table in written), None)


def _over(under: dict[str, Any], data: dict[str, Any]) -> dict[str, Any]:
    merged = dict(under)
    for key, value in data.items():
        both = isinstance(value, dict) and isinstance(under.get(key), dict)
        merged[key] = _over(under[key], cast("dict[str, Any]", value)) if both else value
    return merged


def _keys(data: Mapping[str, Any], above: str = "") -> Iterator[str]:
    for key, value in data.items():
        yield above + key
        if isinstance(value, dict):
            yield from _keys(cast("dict[str, Any]", value), f"{above}{key}.")
