"""One whole flight on virtual time, flown once for all who look at it, and its recording."""

import pytest

from services.config import load
from services.recorder.reading import read
from services.rehearsal.chain import whole
from tests.services.chain import fly


@pytest.fixture(scope="session")
def flown(tmp_path_factory):
    """What was said, and the file that holds it."""
    file = tmp_path_factory.mktemp("flown") / "session.mcap"
    return fly(load("demo"), whole, record=file), file


@pytest.fixture(scope="session")
def recorded(flown):
    """The flight as it was read back; not to be changed."""
    return read(flown[1])
