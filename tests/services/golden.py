"""The virtual flight in a table small enough to read: what every change of behaviour changes.

`make golden` writes it anew; the difference in version control shows what the change did.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from services.config import load
from services.recorder import Session
from services.rehearsal.chain import whole
from tests.services.chain import fly

FILE = Path(__file__).parents[1] / "golden" / "flight.csv"
STEP_S = 0.5
DIGITS = 6

_WORDS = (("safety_state", "phase"), ("safety_state", "level"), ("safety_state", "permit"), ("safety_state", "held"))
_NUMBERS = (
    ("handle", "position_m"),
    ("vehicle_state", "position_m"),
    ("force", "force_N"),
    ("force", "bias_N"),
    ("guidance", "s"),
    ("guidance", "scale"),
    ("guidance", "p_R_d_m"),
    ("setpoint", "kind"),
    ("setpoint", "position_m"),
    ("setpoint", "acceleration_mps2"),
    ("setpoint", "u_A_N"),
    ("sim", "hand_force_N"),
)


def table(session: Session) -> list[list[str]]:
    """A row of names, then one for every half second."""
    t_s = np.arange(STEP_S, session.duration_s, STEP_S)
    names, columns = ["t_s"], [[f"{t:.1f}" for t in t_s]]
    for topic, column in (*_WORDS, *_NUMBERS):
        values = getattr(getattr(session, topic).at(t_s), column)
        for axis, one in zip("xyz" if values.ndim > 1 else [""], np.atleast_2d(values.T), strict=True):
            names.append(f"{topic}.{column}{'.' if axis else ''}{axis}")
            columns.append([_text(value) for value in one])
    return [names, *(list(row) for row in zip(*columns, strict=True))]


def _text(value) -> str:
    return f"{round(value, DIGITS) + 0.0:.{DIGITS}f}" if isinstance(value, float) else str(value)


def read() -> list[list[str]]:
    """The golden table."""
    return [line.split(",") for line in FILE.read_text().splitlines()]


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "session.mcap"
        fly(load("demo"), whole, record=file)
        FILE.parent.mkdir(exist_ok=True)
        FILE.write_text("".join(",".join(row) + "\n" for row in table(Session(file))))
    print(f"{FILE}: {FILE.stat().st_size} bytes", file=sys.stderr)


if __name__ == "__main__":
    main()
