"""The radio: what it does to commands, what an outage costs, and the experiment flown over it. Needs root.

`make bench-net` prints the tables; `--only latency,outage,restarts,flight` chooses, `--delays 0,100,200` flies once for
each one-way delay in ms instead of for 0, 20 and 200.
"""

import argparse
import json
import os
import shutil
import signal
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.net_flight import CARRIED, DELAYS_ms, by_link, by_topic, flight
from benchmarks.two_hosts import BAD, Row, gateways, up
from schemas.topics import CABLE_FORCE, GUIDANCE, HANDLE_STATE
from tests.net.two_hosts import DRONE_IP, TwoHosts, can, lines, read_until

OUTAGE_s = 2.0
RESTARTED = {
    "ground_gateway": GUIDANCE.key,
    "guiding_controller": GUIDANCE.key,
    "tracker": HANDLE_STATE.key,
    "simulator": HANDLE_STATE.key,
}


def main() -> int:
    """As the module says."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--only", default="latency,outage,restarts,flight")
    parser.add_argument("--delays", default="")
    wanted = parser.parse_args()
    if not can():
        print("bench-net needs root, network namespaces and /dev/net/tun", file=sys.stderr)
        return 2
    delays = [float(word) for word in wanted.delays.split(",") if word]
    for name in wanted.only.split(","):
        folder = Path(tempfile.mkdtemp(prefix="clew-net-"))
        try:
            show(*(flight(folder, delays) if name == "flight" else BENCHES[name](folder)))
            if name == "flight":
                first = folder / f"{(delays or DELAYS_ms)[0]:g}"
                show(*by_link(json.loads((first / CARRIED).read_text())))
                show(*by_topic(first))
        finally:
            shutil.rmtree(folder)
    return 0


def show(title: str, columns: Row, rows: list[Row]) -> None:
    """One table, with the load it was measured under."""
    table = Table(*columns, title=title, caption=f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    for row in rows:
        table.add_row(*row)
    Console(width=140).print(table)


def latency(folder: Path) -> tuple[str, Row, list[Row]]:
    """Guidance at 100 Hz over the bad radio, alone and with bulk that fills it."""
    rows: list[Row] = []
    with up(folder) as hosts:
        gateways(hosts)
        for name, how, bulk in (
            ("20±5 ms", BAD | {"loss": 0.0}, False),
            ("20±5 ms, bulk", BAD | {"loss": 0.0}, True),
            ("20±5 ms, 5 % loss", BAD, False),
            ("20±5 ms, 5 % loss, bulk", BAD, True),
        ):
            hosts.shape(**how)
            bare = hosts.python("drone", "benchmarks.bare_datagrams", "hear", "24")
            read_until(bare, "listening")
            mouth = hosts.python("ground", "benchmarks.bare_datagrams", "say", DRONE_IP, "20")
            taken, refused = conversation(hosts, 20.0, bulk=bulk)
            reference = sorted(lines(bare.communicate(timeout=30.0)[0])[-1]["ages_s"])
            mouth.communicate(timeout=30.0)
            del hosts.processes[2:]
            rows.append(
                (name, *(f"{1e3 * reference[int(q * len(reference))]:.1f}" for q in (0.5, 0.99)))
                + _ages(taken, refused.get(GUIDANCE.key, 0), how["delay_ms"])
            )
    columns = (
        "5 Mbit/s",
        "bare UDP p50 ms",
        "p99",
        "p50 ms",
        "of delay",
        "p99 ms",
        "of delay",
        "max ms",
        "lost %",
        "overtaken or too old %",
    )
    return "guidance at 100 Hz, ground to drone, age on arrival", columns, rows


def conversation(hosts: TwoHosts, seconds: float, *, bulk: bool) -> tuple[list[dict[str, Any]], dict[str, int]]:
    """What the bridge hears of the guiding controller."""
    profiles = {host: str(hosts.folder / f"{host}.toml") for host in ("drone", "ground")}
    before = len(hosts.processes)
    ear = hosts.end("drone", "ear", profiles["drone"], "px4_bridge", str(seconds + 3.0), f"+{GUIDANCE.key}")
    read_until(ear, "listening")
    if bulk:
        crowd = hosts.end("drone", "ear", profiles["drone"], "safety_supervisor", str(seconds + 3.0), "sim/truth")
        read_until(crowd, "listening")
        hosts.end("ground", "voice", profiles["ground"], "simulator", "sim/truth", "500", str(seconds), "800")
    hosts.end("ground", "voice", profiles["ground"], "guiding_controller", GUIDANCE.key, "100", str(seconds))
    started = hosts.processes[before + 1 :]
    *taken, last = lines(ear.communicate(timeout=60.0)[0])
    hosts.processes.remove(ear)
    for process in started:
        process.communicate(timeout=30.0)
        hosts.processes.remove(process)
    return taken, last["rejected"]


def _ages(taken: list[dict[str, Any]], refused: int, delay_ms: float) -> Row:
    """Both hosts have this machine's clock, and `said_ns` is not moved to another: the true age, whatever is known of clocks."""
    ages = sorted(entry["t_s"] * 1e3 - entry["said"]["said_ns"] * 1e-6 for entry in taken)
    seqs = [entry["seq"] for entry in taken]
    p50, p99 = ages[len(ages) // 2], ages[int(0.99 * len(ages))]
    said = seqs[-1] - seqs[0] + 1
    lost = max(0, said - len(seqs) - refused)
    return (
        f"{p50:.1f}",
        f"{p50 / delay_ms:.2f}",
        f"{p99:.1f}",
        f"{p99 / delay_ms:.2f}",
        f"{ages[-1]:.0f}",
        f"{100.0 * lost / said:.2f}",
        f"{100.0 * refused / said:.2f}",
    )


def outage(folder: Path) -> tuple[str, Row, list[Row]]:
    """Five outages of 2 s each, on a clean and on a lossy radio."""
    rows: list[Row] = []
    with up(folder) as hosts:
        gateways(hosts)
        for name, how in (("20±5 ms", BAD | {"loss": 0.0}), ("20±5 ms, 5 % loss", BAD)):
            hosts.shape(**how)
            backs, taken = outages(hosts, 5)
            guidance = [entry for entry in taken if entry["key"] == GUIDANCE.key]
            local = [entry["t_s"] for entry in taken if entry["key"] == CABLE_FORCE.key]
            after = sorted(min(e["t_s"] for e in guidance if e["t_s"] > back) - back for back in backs)
            gap = max(b - a for a, b in pairwise(local))
            oldest = max(entry["age_s"] for entry in guidance)
            rows.append((name, *(f"{x:.2f}" for x in (after[0], after[2], after[-1], oldest)), f"{gap * 1e3:.0f}"))
    columns = ("5 Mbit/s", "back after s, best", "median", "worst", "oldest acted on s", "longest onboard gap ms")
    return f"outages of {OUTAGE_s:g} s; onboard: force/cable at 250 Hz", columns, rows


def outages(hosts: TwoHosts, count: int) -> tuple[list[float], list[dict[str, Any]]]:
    """When the radio came back each time, and what the bridge heard meanwhile."""
    profiles, seconds = {host: str(hosts.folder / f"{host}.toml") for host in ("drone", "ground")}, 6.0 * count + 6.0
    keys = (GUIDANCE.key, CABLE_FORCE.key)
    ear = hosts.end("drone", "ear", profiles["drone"], "px4_bridge", str(seconds + 2.0), *keys)
    read_until(ear, "listening")
    hosts.end("ground", "voice", profiles["ground"], "guiding_controller", GUIDANCE.key, "100", str(seconds))
    hosts.end("drone", "voice", profiles["drone"], "force_estimator", CABLE_FORCE.key, "250", str(seconds))
    time.sleep(2.0)
    backs: list[float] = []
    for _ in range(count):
        hosts.shape(down=True)
        time.sleep(OUTAGE_s)
        hosts.shape(down=False)
        backs.append(time.monotonic())
        time.sleep(4.0)
    *taken, _ = lines(ear.communicate(timeout=60.0)[0])
    hosts.processes.remove(ear)
    for process in hosts.processes[2:]:
        process.communicate(timeout=30.0)
    del hosts.processes[2:]
    return backs, taken


def restarts(folder: Path) -> tuple[str, Row, list[Row]]:
    """Each service of the ground killed three times, and started again 0.2 s later, as systemd does."""
    rows: list[Row] = []
    with up(folder) as hosts:
        gateways(hosts)
        hosts.shape(**BAD | {"loss": 0.0})
        profiles = {host: str(folder / f"{host}.toml") for host in ("drone", "ground")}
        for name in ("simulator", "tracker", "guiding_controller"):
            hosts.clew("ground", "run", name, "--profile", profiles["ground"])
        for name, key in RESTARTED.items():
            took_s = sorted(restart(hosts, profiles, name, key) for _ in range(3))
            rows.append((name, key, *(f"{seconds:.2f}" for seconds in took_s)))
    return (
        "ground services killed: silence of the topic on the drone",
        ("killed", "topic", "best s", "median", "worst"),
        rows,
    )


def restart(hosts: TwoHosts, profiles: dict[str, str], name: str, key: str) -> float:
    """For how long the drone did not hear of it."""
    ear = hosts.end("drone", "ear", profiles["drone"], "px4_bridge", "9", key)
    read_until(ear, "listening")
    time.sleep(3.0)
    os.kill(int((hosts.run_dir("ground") / "t" / f"{name}.pid").read_text()), signal.SIGKILL)
    time.sleep(0.2)
    service = "gateway" if name.endswith("gateway") else name
    hosts.clew("ground", "run", service, "--profile", profiles["ground"])
    *taken, _ = lines(ear.communicate(timeout=60.0)[0])
    hosts.processes.remove(ear)
    return max(b["t_s"] - a["t_s"] for a, b in pairwise(taken))


BENCHES = {"latency": latency, "outage": outage, "restarts": restarts}

if __name__ == "__main__":
    sys.exit(main())
