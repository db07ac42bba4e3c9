"""How measurements are printed: a table under the load that it was made at."""

import os
from collections.abc import Sequence

from rich.table import Table

from services.console.terminal import console


def quantile_ms(values_ns: Sequence[int], q: float) -> float:
    return sorted(values_ns)[int(q * (len(values_ns) - 1))] * 1e-6


def show(rows: Sequence[Sequence[str]], columns: Sequence[str]) -> None:
    table = Table(*columns, caption=f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    for row in rows:
        table.add_row(*row)
    console().print(table)
