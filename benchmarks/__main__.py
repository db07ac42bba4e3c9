"""`make bench`: every measurement of the project, one after the other, with the machine it was made on."""

import os
import platform
import subprocess
import sys

from benchmarks import flight_demo, hop, kilohertz, recordings, timers
from benchmarks.table import show
from services.recorder.origin import processor


def machine() -> str:
    """Name, processor, cores and load."""
    load = " ".join(f"{x:.1f}" for x in os.getloadavg())
    return f"{platform.node()}: {processor()}, {os.cpu_count()} cores, Python {platform.python_version()}, load {load}"


def main() -> None:
    """Print every table."""
    for title, measure in (
        ("The demo", lambda: flight_demo.run(1)),
        ("One hop at 1 kHz, pydantic at both ends, beside bare Zenoh bytes", lambda: show(hop.run(), hop.COLUMNS)),
        ("A 1 kHz loop beside a bare timerfd", lambda: show(timers.run(), timers.COLUMNS)),
        ("Observer and filter at the paper's IMU rate", lambda: show(kilohertz.run(), kilohertz.COLUMNS)),
        (
            "A campaign's crowd beside one person at a time",
            lambda: subprocess.run([sys.executable, "-m", "benchmarks.campaign"], check=True),
        ),
        ("Recordings: written, read, reported, run again", recordings.run),
        ("MAVLink, both ends", lambda: subprocess.run([sys.executable, "-m", "benchmarks.mavlink"], check=True)),
    ):
        print(f"\n## {title}\n{machine()}\n", flush=True)
        measure()


if __name__ == "__main__":
    main()
