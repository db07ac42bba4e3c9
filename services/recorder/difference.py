"""Where two messages part."""

from typing import Any, NamedTuple

from pydantic_core import from_json

ABSENT = "absent"


class Difference(NamedTuple):
    """The first field that differs between a message as recorded and as said again, `t_s` into the session."""

    topic: str
    seq: int
    t_s: float
    field: str
    recorded: Any
    said: Any

    def __str__(self) -> str:
        where = f" in {self.field}" if self.field else ""
        return (
            f"{self.topic} {self.seq} at {self.t_s:.3f} s differs{where}: {self.recorded} was recorded, now {self.said}"
        )


def difference(topic: str, recorded: bytes | None, said: bytes | None, t_s: float) -> Difference:
    """Of two payloads that are not equal; None is a message that is not there."""
    one, other = (from_json(payload) if payload else ABSENT for payload in (recorded, said))
    seq = (one if recorded else other)["seq"]
    return Difference(topic, seq, t_s, *(_first(one, other) or ("", "the same values", "in other words")))


def _first(one: Any, other: Any, where: str = "") -> tuple[str, Any, Any] | None:
    """Depth first, in the order of the recorded message's fields."""
    if isinstance(one, dict) and isinstance(other, dict):
        names: dict[str, None] = dict.fromkeys([*one, *other])  # pyright: ignore[reportUnknownArgumentType]
        parts = (
            (f"{where}.{name}" if where else name, one.get(name, ABSENT), other.get(name, ABSENT)) for name in names
        )  # pyright: ignore
        return next((found for name, a, b in parts if (found := _first(a, b, name))), None)
    return None if one == other and type(one) is type(other) else (where, one, other)
