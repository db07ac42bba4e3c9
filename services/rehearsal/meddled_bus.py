"""A memory bus on which the messages of a topic can be dropped, frozen, delayed, doubled, swapped or garbled."""

import asyncio
import itertools
import json
from collections.abc import Callable, Sequence
from typing import Any

from schemas.topics import Stance
from services.runtime.memory_bus import MemoryBus

Meddle = Callable[[bytes], Sequence[tuple[float, bytes]]]
"""What becomes of a payload: none, one or more, each after a delay in s."""
VECTORS = ("_m", "_mps", "_N", "_mps2")
HEADER = ("seq", "stamp_ns", "inputs")


class MeddledBus(MemoryBus):
    """Faults are data that may change at any time: `meddle[key]` decides what becomes of a key's payloads."""

    def __init__(self) -> None:
        super().__init__()
        self.meddle: dict[str, Meddle] = {}

    def put(self, key: str, payload: bytes, stance: Stance) -> None:
        """As MemoryBus.put, unless somebody meddles."""
        if key not in self.meddle:
            super().put(key, payload, stance)
            return
        for delay_s, changed in self.meddle[key](payload):
            if delay_s:
                asyncio.get_running_loop().call_later(delay_s, super().put, key, changed, stance)
            else:
                super().put(key, changed, stance)


def dropped(payload: bytes) -> Sequence[tuple[float, bytes]]:
    """Nothing arrives."""
    return ()


def delayed(by_s: float) -> Meddle:
    """Everything arrives late."""
    return lambda payload: [(by_s, payload)]


def doubled(payload: bytes) -> Sequence[tuple[float, bytes]]:
    """Everything arrives twice, the second time 30 ms later."""
    return [(0.0, payload), (0.03, payload)]


def swapped() -> Meddle:
    """Each second message arrives after its successor."""
    late = itertools.cycle((0.0, 0.025))
    return lambda payload: [(next(late), payload)]


def frozen() -> Meddle:
    """New headers, the old content."""
    first: list[dict[str, Any]] = []

    def freeze(fields: dict[str, Any]) -> dict[str, Any]:
        first.append(fields) if not first else None
        return first[0] | {name: fields[name] for name in HEADER}

    return changed(freeze)


def changed(how: Callable[[dict[str, Any]], dict[str, Any]]) -> Meddle:
    """Each message's fields are put through `how`."""
    return lambda payload: [(0.0, json.dumps(how(json.loads(payload))).encode())]


def vectors(how: Callable[[dict[str, Any]], dict[str, Any]]) -> Meddle:
    """Each vector of a message is put through `how`."""

    def each(fields: dict[str, Any]) -> dict[str, Any]:
        return {k: how(fields[k]) if k.endswith(VECTORS) and isinstance(fields[k], dict) else fields[k] for k in fields}

    return changed(each)


def not_a_number(fields: dict[str, Any]) -> dict[str, Any]:
    """A vector whose first component is NaN."""
    return fields | {"x": float("nan")}


def thousandfold(fields: dict[str, Any]) -> dict[str, Any]:
    """A vector in millimetres or millinewtons."""
    return {k: 1000.0 * v for k, v in fields.items()}


def north_east_down(fields: dict[str, Any]) -> dict[str, Any]:
    """A vector in the autopilot's frame."""
    return {"x": fields["y"], "y": fields["x"], "z": -fields["z"]}


def shifted(by_s: float) -> Meddle:
    """Stamps of a clock that has jumped."""
    return changed(lambda m: m | {"stamp_ns": max(m["stamp_ns"] + round(1e9 * by_s), 0)})
