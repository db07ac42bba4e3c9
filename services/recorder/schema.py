"""JSON Schemas of messages, in the narrow dialect that log viewers parse.

Viewers (Lichtblick, Foxglove, PlotJuggler) turn a schema into a flat table of fields. They take objects of booleans,
strings, numbers, integers, objects, and arrays with one kind of item; a named constant is an integer with `oneOf`. They
throw on everything else that a JSON Schema may hold, and a topic whose schema throws cannot be shown.
"""

import json
from collections.abc import Iterator
from enum import IntEnum
from typing import Any

from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import core_schema

from schemas.message import Message

Schema = dict[str, Any]

_PRIMITIVES = {"boolean", "string", "number", "integer"}
_KEPT = ("type", "description", "properties", "required", "items", "additionalProperties", "enum", "oneOf", "minimum")


class _NamedConstants(GenerateJsonSchema):
    """Integer enumerations become `oneOf` constants with titles, which viewers show by name."""

    def enum_schema(self, schema: core_schema.EnumSchema) -> Schema:
        if not issubclass(schema["cls"], IntEnum):
            return super().enum_schema(schema)
        return {"type": "integer", "oneOf": [{"const": m.value, "title": m.name} for m in schema["members"]]}


def json_schema(message: type[Message]) -> Schema:
    """The schema of a message type, without references.

    Raises ValueError naming the field where the type holds what no viewer can show: an optional, a union, a tuple.
    """
    raw = message.model_json_schema(mode="serialization", schema_generator=_NamedConstants)
    flat = _inlined(raw, raw.get("$defs", {}))
    if found := next(unviewable(flat, message.__name__), None):
        raise ValueError(f"no viewer can show {found}")
    return flat


def schema_text(message: type[Message]) -> bytes:
    """`json_schema` as it is stored in a recording."""
    return json.dumps(json_schema(message), separators=(",", ":"), ensure_ascii=False).encode()


def _inlined(node: Schema, definitions: dict[str, Schema]) -> Schema:
    """A copy in which every reference is replaced by what it refers to and only what viewers read is kept."""
    if "$ref" in node:
        node = definitions[node["$ref"].removeprefix("#/$defs/")] | node
    kept = {key: node[key] for key in (*_KEPT, "anyOf", "allOf", "prefixItems") if key in node}
    if "properties" in kept:
        kept["properties"] = {name: _inlined(part, definitions) for name, part in kept["properties"].items()}
    for key in ("items", "additionalProperties"):
        if isinstance(kept.get(key), dict):
            kept[key] = _inlined(kept[key], definitions)
    return kept


def unviewable(node: Schema, where: str) -> Iterator[str]:
    """Every place in an object's schema at which a viewer's parser would throw, with the reason."""
    if node.get("type") != "object":
        yield f"{where}: type {node.get('type')!r}, not 'object'"
    for name, field in node.get("properties", {}).items():
        yield from _unviewable_field(field, f"{where}.{name}")


def _unviewable_field(field: Schema, where: str) -> Iterator[str]:
    for word in ("$ref", "anyOf", "allOf", "not", "prefixItems"):
        if word in field:
            yield f"{where}: {word}"
    if not all(isinstance(one.get("const"), int) and "title" in one for one in field.get("oneOf", [])):
        yield f"{where}: oneOf of something other than named integers"
    match field.get("type"):
        case "object":
            yield from unviewable(field, where)
        case "array":
            yield from _unviewable_items(field.get("items"), f"{where}[]")
        case kind if not isinstance(kind, str) or kind not in _PRIMITIVES:
            yield f"{where}: type {kind!r}"
        case _:
            pass


def _unviewable_items(items: object, where: str) -> Iterator[str]:
    if not isinstance(items, dict):
        yield f"{where}: items are not of one kind"
    elif items.get("type") == "array":  # pyright: ignore[reportUnknownMemberType]
        yield f"{where}: an array in an array"
    else:
        yield from _unviewable_field(items, where)  # pyright: ignore[reportUnknownArgumentType]
