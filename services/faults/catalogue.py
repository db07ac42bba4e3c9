"""All faults that can be tried on virtual time. What needs real processes is in tests/processes."""

from services.faults.fault import Fault
from services.faults.rows.hosts import clocks, operators
from services.faults.rows.messages import messages
from services.faults.rows.people import people
from services.faults.rows.processes import processes
from services.faults.rows.sensing import sensing
from services.faults.rows.vehicles import vehicles


def every() -> tuple[Fault, ...]:
    """The whole campaign."""
    return (*processes(), *messages(), *sensing(), *vehicles(), *people(), *clocks(), *operators())


def named(name: str) -> Fault | None:
    """The fault of that name."""
    return next((fault for fault in every() if fault.name == name), None)
