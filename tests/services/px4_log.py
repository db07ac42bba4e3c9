"""A flight on real PX4 as it came over MAVLink, with the simulator's truth beside it: test data where there is no PX4.

`python -m tests.services.px4_log` flies it anew and writes both files; it needs PX4_BIN. The log has the form of a ground
station's tlog (microseconds, big-endian, before each packet), compressed, with only the messages that the bridge asks for.
"""

import csv
import io
import lzma
import struct
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import development as dialect

from schemas.safety import Phase
from schemas.topics import TRUTH
from services.px4_bridge.telecommand import RATES_Hz
from services.px4_bridge.telemetry import Telemetry
from services.rehearsal import px4_flight
from services.rehearsal.chain import Stage
from services.rehearsal.quick import quicker
from tests.services import px4_chain

FOLDER = Path(__file__).parents[1] / "data"
LOG, TRUTHS = FOLDER / "px4_flight.tlog.xz", FOLDER / "px4_flight_truth.csv.xz"
_STAMP = struct.Struct(">Q")
_COLUMNS = ("t_us", "phase", "f_x_N", "f_y_N", "f_z_N", "p_x_m", "p_y_m", "p_z_m")
_KEEP_EVERY = 4  # of the truth's 100 Hz


class Packet(NamedTuple):
    """One message and when it arrived."""

    t_us: int
    name: str
    fields: dict[str, Any]


class Truth(NamedTuple):
    """Times (N,) in s; the phase then; the cable's force on the handle and the robot's position, (N, 3)."""

    t_s: np.ndarray
    phase: np.ndarray
    f_c_W: np.ndarray
    p_W: np.ndarray


def packets() -> Iterator[Packet]:
    """All messages in the order of their arrival."""
    data, at = lzma.decompress(LOG.read_bytes()), 0
    parser: Any = dialect.MAVLink(None)
    while at < len(data):
        (t_us,) = _STAMP.unpack_from(data, at)
        end = at + _STAMP.size + 12 + data[at + _STAMP.size + 1]
        (message,) = parser.parse_buffer(data[at + _STAMP.size : end])
        yield Packet(t_us, message.get_type(), message.to_dict())
        at = end


def truth() -> Truth:
    """What was so."""
    rows = list(csv.reader(io.StringIO(lzma.decompress(TRUTHS.read_bytes()).decode())))[1:]
    numbers = np.array([[float(x) for x in (row[0], *row[2:])] for row in rows])
    return Truth(1e-6 * numbers[:, 0], np.array([row[1] for row in rows]), numbers[:, 1:4], numbers[:, 4:7])


def record() -> None:
    """Fly the short experiment on PX4 and write both files."""
    log = io.BytesIO()
    with tempfile.TemporaryDirectory() as folder:
        config = quicker(px4_chain.px4_config(Path(folder)))
        wanted = {*Telemetry(config.px4_bridge.vehicle).messages, *RATES_Hz, "PARAM_VALUE"}

        async def script(stage: Stage) -> None:
            def keep(name: str, packet: bytes) -> None:
                if name in wanted:
                    log.write(_STAMP.pack(stage.operator.clock.now_ns() // 1000) + packet)

            stage.flight.vehicle.on_packet = keep
            await px4_flight.started(stage)
            for name in config.px4_bridge.px4:
                stage.flight.vehicle.ask_parameter(name)
            await stage.until(lambda state: state.phase is Phase.LANDED, 150.0)

        flight = px4_flight.fly(config, script)
    FOLDER.mkdir(exist_ok=True)
    LOG.write_bytes(lzma.compress(log.getvalue(), preset=9))
    TRUTHS.write_bytes(lzma.compress(_truth_csv(flight).encode(), preset=9))


def _truth_csv(flight: Any) -> str:
    states = [(m.stamp_ns, m.phase.value) for m in flight.said["safety/state"]]
    times = np.array([t for t, _ in states])
    out = io.StringIO()
    table = csv.writer(out)
    table.writerow(_COLUMNS)
    for m in flight.said[TRUTH.key][::_KEEP_EVERY]:
        phase = states[max(int(np.searchsorted(times, m.stamp_ns)) - 1, 0)][1]
        numbers = [*m.cable_force_N.array().tolist(), *m.robot_position_m.array().tolist()]
        table.writerow([m.stamp_ns // 1000, phase, *(f"{x:.4f}" for x in numbers)])
    return out.getvalue()


if __name__ == "__main__":
    if not px4_chain.PX4_BIN:
        sys.exit("PX4_BIN is not set: no real PX4 to fly")
    record()
