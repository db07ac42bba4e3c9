"""What is recorded can be shown: every topic's schema keeps to the dialect of log viewers."""

import json
from enum import IntEnum, StrEnum

import pytest

from schemas.message import Message, Part
from schemas.safety import Level, SafetyState
from schemas.topics import TOPICS
from services.recorder.schema import json_schema, schema_text, unviewable


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.key)
def test_a_viewer_can_show_every_topic(topic):
    assert list(unviewable(json_schema(topic.type), topic.key)) == []
    text = schema_text(topic.type).decode()
    assert not any(f'"{word}"' in text for word in ("$ref", "$defs", "anyOf", "allOf", "prefixItems", "null"))
    assert json.loads(text)["type"] == "object"


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.key)
def test_a_schema_names_every_field_of_the_message(topic):
    assert _fields(json_schema(topic.type)) == _members(topic.type)


def test_integer_enumerations_keep_their_names():
    level = json_schema(SafetyState)["properties"]["level"]
    assert {one["title"]: one["const"] for one in level["oneOf"]} == {m.name: m.value for m in Level}


class Colour(StrEnum):
    RED = "red"


class Size(IntEnum):
    BIG = 3


class Inner(Part):
    sizes: list[Size]
    maybe: int | None = None


class Optional(Message):
    maybe: float | None = None


class Union(Message):
    either: int | str = 0


class Pair(Message):
    pair: tuple[int, float] = (0, 0.0)


class Nested(Message):
    grid: list[list[float]]


class Deep(Message):
    inner: list[Inner]


class Nothing(Message):
    nothing: None = None


class Fine(Message):
    colours: list[Colour]
    sizes: list[Size]
    counts: dict[str, int]


@pytest.mark.parametrize(
    ("kind", "where"),
    [
        (Optional, "Optional.maybe"),
        (Union, "Union.either"),
        (Pair, "Pair.pair"),
        (Nested, "Nested.grid"),
        (Deep, r"Deep.inner\[\].maybe"),
        (Nothing, "Nothing.nothing"),
    ],
)
def test_what_no_viewer_can_show_is_refused_by_name(kind, where):
    with pytest.raises(ValueError, match=where):
        json_schema(kind)


def test_lists_of_enumerations_and_maps_are_fine():
    properties = json_schema(Fine)["properties"]
    assert properties["colours"]["items"] == {"type": "string", "enum": ["red"]}
    assert properties["sizes"]["items"] == {"type": "integer", "oneOf": [{"const": 3, "title": "BIG"}]}
    assert properties["counts"]["type"] == "object"


def _fields(schema):
    """Names of an object's fields, nested."""
    return {name: _fields(part) for name, part in schema.get("properties", {}).items()}


def _members(part):
    if not (isinstance(part, type) and issubclass(part, Part)):
        return {}
    return {name: _members(field.annotation) for name, field in part.model_fields.items()}
