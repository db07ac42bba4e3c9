"""Columns from messages: what a log's JSON looks like as numpy arrays."""

from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic_core import from_json

from schemas.message import Message, Part, Quaternion, Vec3

Array = NDArray[Any]
Row = dict[str, Any]
Table = dict[str, Array]

_COMPONENTS = {Vec3: ("x", "y", "z"), Quaternion: ("w", "x", "y", "z")}
_DTYPES: dict[type, type] = {float: np.float64, int: np.int64, bool: np.bool_}


def rows(payloads: Sequence[bytes]) -> list[Row]:
    """Parsed messages, all at once."""
    return from_json(b"[" + b",".join(payloads) + b"]")


_BLOCK = 4096


def table_of(message: type[Message], payloads: Sequence[bytes]) -> Table:
    """As `table`, parsed in blocks, so that what is in memory is the columns and not the messages too."""
    blocks = [table(message, rows(payloads[i : i + _BLOCK])) for i in range(0, len(payloads), _BLOCK)]
    if len(blocks) < 2:
        return blocks[0] if blocks else table(message, [])
    names = dict.fromkeys(name for block in blocks for name in block)  # an input that one block has, others may lack
    lacking = [np.zeros(len(block["seq"]), np.int64) for block in blocks]
    pieces = ([block.get(name, zero) for block, zero in zip(blocks, lacking, strict=True)] for name in names)
    return {name: np.concatenate(piece) for name, piece in zip(names, pieces, strict=True)}


def table(message: type[Message], messages: Sequence[Row]) -> Table:
    """One array per field, first axis the messages.

    Vec3 is (N, 3), Quaternion (N, 4) with w first, text and lists (N,) of objects; a field within a part has a dotted
    name. `inputs` gives one column `inputs.<topic>` for each topic named: its seq, 0 where it was not used.
    """
    columns = _columns(message, messages)
    used = sorted({key for row in messages for key in row["inputs"]})
    inputs = {f"inputs.{key}": np.array([row["inputs"].get(key, 0) for row in messages], np.int64) for key in used}
    return columns | inputs


def _columns(part: type[Part], messages: Sequence[Row], prefix: str = "") -> Table:
    found: Table = {}
    for name, field in part.model_fields.items():
        kind = field.annotation
        if field.is_required():
            values = [row[name] for row in messages]
        else:  # a recording may be older than the field
            default = _plain(field.get_default(call_default_factory=True))
            values = [row.get(name, default) for row in messages]
        if isinstance(kind, type) and issubclass(kind, Part) and kind not in _COMPONENTS:
            found |= _columns(kind, values, f"{prefix}{name}.")
        elif name != "inputs":
            found[prefix + name] = _column(kind, values)
    return found


def _plain(value: Any) -> Any:
    """As it stands in a parsed message."""
    return value.model_dump() if isinstance(value, Part) else value


def _column(kind: Any, values: list[Any]) -> Array:
    if kind in _COMPONENTS:
        names = _COMPONENTS[kind]
        flat = np.array([[value[name] for name in names] for value in values], np.float64)
        return flat.reshape(len(values), len(names))
    column: Array = np.empty(len(values), np.dtype(_DTYPES.get(kind, _of_enum(kind))))
    column[:] = values
    return column


def _of_enum(kind: Any) -> type:
    return np.int64 if isinstance(kind, type) and issubclass(kind, int) and issubclass(kind, Enum) else object


def sample(t: Array, columns: Array, at: Array) -> Array:
    """`columns` (N, ...) of samples at times `t` (N,), linear between them, held outside; at `at` (M,)."""
    each: Callable[[Array], Array] = lambda column: np.interp(at, t, column)  # noqa: E731
    return each(columns) if columns.ndim == 1 else np.stack([each(column) for column in columns.T], axis=-1)
