"""The architecture as tests: what may import what, and that the table and the services agree."""

import ast
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import schemas
import services
from schemas.topics import SERVICES
from services.console.start import module_of
from services.recorder.rerun_subjects import SUBJECTS as RERUN

ROOT = Path(__file__).parents[2]
DEVICES = {
    "service",
    *("sources", "capture", "driver"),
    "stage",
    "ears",
    "vehicle",
    "vehicle_protocol",
    "commanded",
    "mavlink",
    "mavlink_streams",
    "wire",
    "px4_hil",
    "px4_process",
    *("session", "start", "console", "refusals", "certs"),  # the gateway's
}
LAW_FOLDERS = (
    "tracker",
    "force_estimator",
    "guiding_controller",
    "safety_supervisor",
    "px4_bridge",
    "simulator",
    "gateway",
)
LAWS = sorted(
    f"services.{folder}.{file.stem}"
    for folder in LAW_FOLDERS
    for file in (ROOT / "services" / folder).glob("*.py")
    if file.stem not in DEVICES | {"__init__"}
)
FORBIDDEN = {"zenoh", "mavsdk", "pymavlink", "asyncio", "rich", "typer", "matplotlib", "mcap"}


def imported_by(*modules: str) -> set[str]:
    """The top-level names that importing them pulls in, in a fresh interpreter."""
    script = f"import sys, {', '.join(modules)}; print(*{{name.split('.')[0] for name in sys.modules}})"
    return set(
        subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True).stdout.split()
    )


def test_laws_know_no_bus_no_device_and_no_clock():
    assert len(LAWS) > 25
    found = imported_by(*LAWS) & (FORBIDDEN - {"asyncio"})
    assert not found


def test_the_contract_stands_alone():
    names = [f"schemas.{file.stem}" for file in (ROOT / "schemas").glob("*.py") if file.stem != "__init__"]
    assert not imported_by(*names) & (FORBIDDEN | {"services", "scipy"} - {"asyncio"})


def test_no_law_reads_a_clock_or_draws_random_numbers():
    for name in LAWS:
        source = Path(importlib.import_module(name).__file__ or "").read_text()
        for word in ("import time", "import random", "np.random", "time.monotonic", "datetime"):
            assert word not in source, f"{name} has {word}"


@pytest.mark.parametrize("package", [services, schemas])
def test_the_packages_are_this_repositorys(package):
    assert [Path(path) for path in package.__path__] == [ROOT / package.__name__]


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_is_named_like_its_module(name):
    run = importlib.import_module(module_of(name)).run
    assert inspect.iscoroutinefunction(run)
    assert list(inspect.signature(run).parameters) == ["node", "config"]


def test_no_service_waits_for_scipy_or_matplotlib_to_start():
    """Scipy was a third of a service's start, and one that was killed is waited for in flight."""
    assert not imported_by("services.console.cli", *map(module_of, SERVICES)) & {"scipy", "matplotlib"}


def test_what_is_run_again_multiplies_without_blas():
    """Its kernels, and so the last bits, are chosen by the processor: a rerun elsewhere would differ. See physics.dot."""
    ran = [file for folder in set(LAW_FOLDERS) & set(RERUN) for file in (ROOT / "services" / folder).glob("*.py")]
    assert len(ran) > 30
    found = [
        f"{file.name}:{node.lineno}"
        for file in ran
        for node in ast.walk(ast.parse(file.read_text()))
        if (isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult))
        or (isinstance(node, ast.Attribute) and node.attr in {"dot", "linalg", "matmul", "einsum"})
    ]
    assert not found
