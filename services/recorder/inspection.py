"""Whether a recording is complete, and why not; what is not as the present code would write it."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from schemas.topics import BY_KEY
from services.recorder.origin import FORMAT
from services.recorder.reading import Session
from services.recorder.schema import json_schema
from services.recorder.verdict import Count, Verdict
from services.recorder.walk import NO_PHASE_2, elsewhere, guided


@dataclass(frozen=True)
class Findings:
    """`lacking` is why a recording is not complete, empty where it is; `remarks` are worth knowing either way."""

    counts: Mapping[str, Count]
    lacking: list[str]
    remarks: list[str]

    @property
    def complete(self) -> bool:
        """Everything that was said is in the file."""
        return not self.lacking


def inspect(session: Session) -> Findings:
    """Look at every message of a recording."""
    session.prepare(*(key for key in session.keys if key in BY_KEY))
    counted = session.count()
    lacking = [*_endings(session), *_losses(session.verdict, counted), *_nameless(session)]
    return Findings(counted.topics, lacking, [*_versions(session), *_contents(session), *_schemas(session)])


def _endings(session: Session) -> Iterator[str]:
    verdict = session.verdict
    if session.damage:
        yield session.damage
    if verdict.stopped:
        yield f"the recording was stopped: {verdict.stopped}"
    if not verdict.closed:
        yield "the recorder did not come to finish it"


def _losses(verdict: Verdict, counted: Verdict) -> Iterator[str]:
    for key, count in verdict.topics.items():
        if count.missing or count.malformed:
            yield f"{key}: {count.missing} missing, {count.malformed} malformed"
        if count.first_seq > 1:
            yield f"{key}: begins with message {count.first_seq}"
        held = counted.topics.get(key, Count()).received
        if held != count.received:
            yield f"{key}: {count.received} were written, {held} can be read"


def _nameless(session: Session) -> Iterator[str]:
    """Messages that were used by others, and are not there; of what crossed the radio thinned only some can be."""
    known, far = [key for key in session.keys if key in BY_KEY], elsewhere(session)
    whole = [key for key in known if not (BY_KEY[key].radio_Hz and BY_KEY[key].publisher in far)]
    for key in known:
        table = session.table(key)
        for source in whole:
            used = table.get(f"inputs.{source}", np.zeros(0, np.int64))
            absent = np.setdiff1d(used[used > 0], session.table(source)["seq"])
            if len(absent):
                yield f"{key} used {len(absent)} of {source} that are not there, first {absent[0]}"


def _versions(session: Session) -> Iterator[str]:
    written = session.metadata.get("clew.session", {}).get("format", "1")
    if not written.isdecimal():
        yield f"written in format {written!r}, which is none of {FORMAT} or before"
    elif int(written) > FORMAT:
        yield f"written in format {written}, newer than {FORMAT}: what is new in it is not read"
    elif int(written) < FORMAT:
        yield f"written in format {written}: too old to be run again"


def _contents(session: Session) -> Iterator[str]:
    if not guided(session):
        yield NO_PHASE_2
    if unknown := [key for key in session.keys if key not in BY_KEY]:
        yield f"topics that are not known here: {', '.join(unknown)}"


def _schemas(session: Session) -> Iterator[str]:
    """Fields by which a topic's recorded schema and the present one differ."""
    seen: set[str] = set()
    for part in session.parts:
        for channel in part.channels.values():
            key, schema = channel.metadata.get("key", ""), part.schemas.get(channel.schema_id)
            if key in BY_KEY and key not in seen and schema:
                seen.add(key)
                yield from _changes(key, dict(_fields(json.loads(schema.data))), BY_KEY[key].type)


def _changes(key: str, recorded: dict[str, bool], kind: Any) -> Iterator[str]:
    present = dict(_fields(json_schema(kind)))
    if gone := [name for name in recorded if name not in present]:
        yield f"{key}: recorded with {', '.join(gone)}, which messages no longer have"
    if new := [name for name in present if name not in recorded]:
        yield f"{key}: recorded without {', '.join(new)}"


def _fields(schema: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, bool]]:
    for name, field in schema.get("properties", {}).items():
        yield prefix + name, True
        yield from _fields(field, f"{prefix}{name}.")
