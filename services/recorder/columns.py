"""A topic's columns by attribute, and brought onto the times of another topic."""

from typing import Any

import numpy as np

from services.recorder.table import Array, Table, sample


class Columns:
    """`handle.position_m` is an array whose first axis are the messages; `mocap_frame.handle.position_m` a field of a part."""

    def __init__(self, table: Table, name: str, prefix: str = "") -> None:
        self._table, self._name, self._prefix = table, name, prefix

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        full = self._prefix + name
        if full in self._table:
            return self._table[full]
        if any(column.startswith(f"{full}.") for column in self._table):
            return Columns(self._table, f"{self._name}.{name}", f"{full}.")
        raise AttributeError(f"{self._name} has no {name}: it has {', '.join(sorted(self._own()))}")

    def __getitem__(self, name: str) -> Array:
        return self._table[self._prefix + name]

    def __len__(self) -> int:
        return len(self._table["t_s"])

    def __dir__(self) -> list[str]:
        return ["at", *self._own()]

    def __repr__(self) -> str:
        return f"{self._name}: {len(self)} messages, {', '.join(sorted(self._own()))}"

    def at(self, t_s: Array) -> "Columns":
        """The same at other times (M,), s since the session's start: a time-aligned join.

        Floats are linear between messages and held outside; whatever else is there is the last that was said (before
        the first message: the first). A topic without a message cannot be asked: ValueError.
        """
        own_s = self._table["t_s"]
        if not len(own_s):
            raise ValueError(f"{self._name}: nothing was said")
        last = np.maximum(np.searchsorted(own_s, t_s, side="right") - 1, 0)
        joined = {
            name: sample(own_s, column, t_s) if column.dtype == np.float64 else column[last]
            for name, column in self._table.items()
        }
        return Columns(joined | {"t_s": np.asarray(t_s)}, self._name, self._prefix)

    def _own(self) -> set[str]:
        """Names one level below."""
        inside = (name.removeprefix(self._prefix) for name in self._table if name.startswith(self._prefix))
        return {name.partition(".")[0] for name in inside}
