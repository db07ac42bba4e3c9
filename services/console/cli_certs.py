"""`clew certs`: what certs.py does, told in a terminal."""

import sys
from collections.abc import Callable, Sequence

from rich.console import Console
from rich.table import Table

from services.gateway import certs
from services.gateway.certs import CertsError


def init() -> int:
    """Make the authority. Returns the exit code, 2 for bad input."""
    return _tell(lambda: certs.init(certs.folder()), f"authority in {certs.folder()}; keep ca.key on this machine only")


def issue(name: str, role: str, addresses: Sequence[str], days: float) -> int:
    """Make a certificate. Returns the exit code, 2 for bad input."""
    where = certs.folder()
    told = (
        f"copy {where}/ca.pem, {name}.pem and {name}.key to {name}; radio.names of the profile must have {role}:{name}"
    )
    return _tell(lambda: certs.issue(where, name, role, addresses, days), told)


def show() -> int:
    """The table. Returns the exit code: 1 where something is wrong with one."""
    rows: list[tuple[str, ...]] = []
    code = _tell(lambda: rows.extend(certs.show(certs.folder())), "")
    table = Table("name", "role", "addresses", "until", "state")
    for row in rows:
        table.add_row(*row)
    console = Console()
    (console if console.is_terminal else Console(width=200)).print(table)
    return code or int(any(row[-1] != "good" for row in rows))


def _tell(do: Callable[[], object], told: str) -> int:
    try:
        do()
    except (CertsError, OSError) as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2
    if told:
        print(told)  # noqa: T201
    return 0
