"""All of this folder is `faults`: a flight of its own in real time for each test or set of tests."""

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if "tests/processes/" in str(item.path):
            item.add_marker("faults")
            item.add_marker(pytest.mark.timeout(240))
