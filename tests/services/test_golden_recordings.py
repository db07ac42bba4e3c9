"""Recordings of real flights through the present code: what it would have said differently is seen before it flies."""

import math

import pytest
from pydantic_core import from_json

from services.console.rerun import config_with
from services.recorder.reading import read
from services.recorder.rerun import rerun
from services.recorder.rerun_subjects import SUBJECTS
from tests.golden_recordings import PROFILES, unpacked

pytestmark = pytest.mark.slow

TOLERANCE = 1e-6
"""The machine that recorded may round the last bits otherwise; on the machine itself all bytes are equal. The end of the
suite's output says which it was, service by service (tests/conftest.py)."""


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    folder = tmp_path_factory.mktemp("golden")
    files = {profile: unpacked(profile, folder) for profile in PROFILES}
    return {profile: (file, read(file)) for profile, file in files.items()}


@pytest.mark.parametrize("service", SUBJECTS)
@pytest.mark.parametrize("profile", PROFILES)
def test_the_present_code_says_what_was_said_in_flight(recordings, profile, service, record_property):
    file, session = recordings[profile]
    outcome = rerun(session, service, config_with(session, file, []))
    assert outcome.compared > 100
    equal = "bit for bit" if outcome.equal else f"{outcome.differ} of them but for rounding, to {TOLERANCE:g}"
    record_property(
        "rerun", f"{profile}, {service}: {outcome.compared} messages {equal}; recorded on {_where(session)}"
    )
    if not outcome.equal:
        for key, said in outcome.said.items():
            was = session.logs[key].payloads
            assert len(said) == len(was), outcome.first
            pairs = zip(was, said, strict=True)
            assert all(alike(from_json(one), from_json(other)) for one, other in pairs), outcome.first


def _where(session):
    """The machine that recorded, as far as it said."""
    told = session.metadata["clew.session"]
    return f"{told.get('processor', 'an unnamed processor')}, {told['machine']}, numpy {told['numpy']}"


def alike(one, other):
    """The same but for rounding."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(alike(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(alike, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, abs_tol=TOLERANCE)
    return one == other


def test_a_changed_parameter_is_seen(recordings):
    file, session = recordings["demo"]
    outcome = rerun(session, "px4_bridge", config_with(session, file, ["px4_bridge.admittance.k_H_N_per_m=5.1"]))
    assert not outcome.equal
