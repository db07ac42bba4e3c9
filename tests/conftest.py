"""How `make test` shares the suite between processes: what has processes, ports or real time stays in one of them."""

import pytest
from xdist.scheduler import LoadScopeScheduling


class Shared(LoadScopeScheduling):
    """tests/system one after the other, and beside them, file by file, all that is only computed."""

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.split("::")[0]
        return "system" if file.startswith("tests/system/") else file


def pytest_xdist_make_scheduler(config: pytest.Config, log) -> Shared:
    return Shared(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest part begins first."""
    items.sort(key=lambda item: not item.nodeid.startswith("tests/system/"))
