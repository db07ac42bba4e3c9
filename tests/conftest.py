"""How `make test` shares the suite between processes: what has processes, ports or real time stays in one of them."""

import platform

import numpy as np
import pytest
from xdist.scheduler import LoadScopeScheduling

from services.recorder.origin import processor


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


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """What was run again of the recordings of other machines, and on which it was."""
    reports = [report for report in terminalreporter.getreports("passed") if report.when == "call"]
    told = [text for report in reports for name, text in report.user_properties if name == "rerun"]
    if told:
        here = f"{processor()}, {platform.system()} {platform.machine()}, Python {platform.python_version()}"
        terminalreporter.section(f"kept recordings, run again on {here}, numpy {np.__version__}")
        for text in sorted(told):
            terminalreporter.write_line(str(text))
