"""Where two messages part."""

from typing import Any, NamedTuple, cast

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
    one: dict[str, Any] = {} if recorded is None else from_json(recorded)
    other: dict[str, Any] = {} if said is None else from_json(said)
    seq = int((one or other).get("seq", 0))
    if recorded is None or said is None:
        return Difference(topic, seq, t_s, "", one or ABSENT, other or ABSENT)
    return Difference(topic, seq, t_s, *(_first(one, other) or ("", "the same values", "in other words")))


def _first(one: Any, other: Any, where: str = "") -> tuple[str, Any, Any] | None:
    """Depth first, in the order of the recorded message's fields."""
    if not (isinstance(one, dict) and isinstance(other, dict)):
        same = one == other and type(one) is type(other)  # pyright: ignore[reportUnknownArgumentType]
        return None if same else (where, cast("Any", one), other)
    a, b = cast("dict[str, Any]", one), cast("dict[str, Any]", other)
    for name in dict.fromkeys([*a, *b]):
        found = _first(a.get(name, ABSENT), b.get(name, ABSENT), f"{where}.{name}" if where else name)
        if found:
            return found
    return None
