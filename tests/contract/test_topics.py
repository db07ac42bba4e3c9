"""The table is what everything else is derived from, so it must hold together."""

import re
from collections import Counter

import pytest

from schemas.message import Message
from schemas.topics import BY_KEY, HEALTH, OPERATOR, SERVICES, TOPICS, Stance

CHUNK = re.compile(r"@?[a-z][a-z0-9_]*")
PLAIN = {"boolean", "string", "number", "integer", "object", "array"}


def by_key(topics=TOPICS):
    return pytest.mark.parametrize("topic", topics, ids=lambda topic: topic.key)


def schema_nodes(schema):
    """Every schema within a schema."""
    yield schema
    inner = [*schema.get("properties", {}).values(), *schema.get("$defs", {}).values()]
    inner += [schema[word] for word in ("items", "additionalProperties") if isinstance(schema.get(word), dict)]
    for child in inner:
        yield from schema_nodes(child)


def test_keys_are_unique():
    assert [key for key, count in Counter(topic.key for topic in TOPICS).items() if count > 1] == []
    assert {topic.key: topic for topic in TOPICS} == BY_KEY


@by_key()
def test_keys_are_snake_case_chunks(topic):
    assert all(CHUNK.fullmatch(chunk) for chunk in topic.key.split("/"))


@by_key()
def test_who_writes_and_listens_exists(topic):
    assert topic.publisher in (*SERVICES, OPERATOR)
    assert set(topic.subscribers) <= {*SERVICES, OPERATOR}
    assert len(set(topic.subscribers)) == len(topic.subscribers)
    assert topic.publisher not in topic.subscribers


def test_every_service_has_its_health():
    assert set(HEALTH) == set(SERVICES)
    assert all(topic.publisher == name for name, topic in HEALTH.items())


@by_key()
def test_a_command_is_out_of_reach_of_wildcards(topic):
    assert (topic.stance is Stance.COMMAND) == ("@cmd" in topic.key.split("/"))


@by_key()
def test_a_periodic_topic_can_be_stale_and_is_not_at_once(topic):
    if topic.rate_Hz:
        assert 3.0 / topic.rate_Hz < topic.timeout_s < 10.1
    else:
        assert topic.timeout_s == float("inf")


@by_key()
def test_no_schema_surprises_a_log_viewer(topic):
    schema = topic.type.model_json_schema()
    nodes = list(schema_nodes(schema))
    assert schema["type"] == "object"
    for node in nodes:
        assert not {"anyOf", "oneOf", "allOf", "prefixItems", "patternProperties"} & set(node)
        assert "$ref" in node or node["type"] in PLAIN


@by_key()
def test_messages_are_closed_frozen_and_finite(topic):
    assert issubclass(topic.type, Message)
    assert topic.type.model_config.get("extra") == "forbid"
    assert topic.type.model_config.get("frozen") is True
    assert topic.type.model_config.get("allow_inf_nan") is False


@by_key()
def test_each_row_says_what_it_is_about(topic):
    assert topic.about
    assert isinstance(topic.logged, bool)
