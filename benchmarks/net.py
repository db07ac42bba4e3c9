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

from schemas.topics import CABLE_FORCE, GUIDANCE, HANDLE_STATE, TOPICS
from services.config import load
from services.recorder.reading import read
from tests.net.conftest import linked
from tests.net.two_hosts import TwoHosts, can, lines, make_certificates, read_until, stop, write_profile

BAD: dict[str, float] = {"delay_ms": 20.0, "jitter_ms": 5.0, "loss": 0.05, "rate_Mbit_s": 5.0}
QUIET: dict[str, float] = {"delay_ms": 2.0, "jitter_ms": 0.5, "loss": 0.0, "rate_Mbit_s": 0.0}
OUTAGE_s = 2.0
DELAYS_ms = [0.0, 20.0, 200.0]
RESTARTED = {
    "ground_gateway": GUIDANCE.key,
    "guiding_controller": GUIDANCE.key,
    "tracker": HANDLE_STATE.key,
    "simulator": HANDLE_STATE.key,
}
Row = tuple[str, ...]


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
                show(*bandwidth(folder / f"{(delays or DELAYS_ms)[0]:g}"))
        finally:
            shutil.rmtree(folder)
    return 0


def show(title: str, columns: Row, rows: list[Row]) -> None:
    """One table, with the load it was measured under."""
    table = Table(*columns, title=title, caption=f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    for row in rows:
        table.add_row(*row)
    Console(width=140).print(table)


def up(folder: Path, radio: str = "", extra: str = "") -> TwoHosts:
    """Two hosts with certificates and profiles; enter it."""
    make_certificates(folder / "certs")
    for host in ("drone", "ground"):
        write_profile(folder / f"{host}.toml", host, radio, extra)
    return TwoHosts(folder)


def gateways(hosts: TwoHosts) -> None:
    """Both, linked over a good radio."""
    hosts.shape(**QUIET)
    hosts.gateway("drone")
    hosts.gateway("ground")
    linked(hosts)


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
            taken, refused = conversation(hosts, 20.0, bulk=bulk)
            rows.append((name, *_ages(taken, refused.get(GUIDANCE.key, 0), how["delay_ms"])))
    columns = ("5 Mbit/s", "p50 ms", "of delay", "p99 ms", "of delay", "max ms", "lost %", "overtaken or too old %")
    return "guidance at 100 Hz, ground to drone, age on arrival", columns, rows


def conversation(hosts: TwoHosts, seconds: float, *, bulk: bool) -> tuple[list[dict[str, Any]], dict[str, int]]:
    """What the bridge hears of the guiding controller."""
    profiles = {host: str(hosts.folder / f"{host}.toml") for host in ("drone", "ground")}
    ear = hosts.end("drone", "ear", profiles["drone"], "px4_bridge", str(seconds + 3.0), GUIDANCE.key)
    read_until(ear, "listening")
    if bulk:
        crowd = hosts.end("drone", "ear", profiles["drone"], "safety_supervisor", str(seconds + 3.0), "sim/truth")
        read_until(crowd, "listening")
        hosts.end("ground", "voice", profiles["ground"], "simulator", "sim/truth", "500", str(seconds), "800")
    hosts.end("ground", "voice", profiles["ground"], "guiding_controller", GUIDANCE.key, "100", str(seconds))
    *taken, last = lines(ear.communicate(timeout=60.0)[0])
    hosts.processes.remove(ear)
    for process in hosts.processes[2:]:
        process.communicate(timeout=30.0)
    del hosts.processes[2:]
    return taken, last["rejected"]


def _ages(taken: list[dict[str, Any]], refused: int, delay_ms: float) -> Row:
    ages = sorted(entry["age_s"] * 1e3 for entry in taken)
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


def flight(folder: Path, delays_ms: list[float]) -> tuple[str, Row, list[Row]]:
    """The experiment of `make demo`, split over two hosts; one flight for each delay, and without a delay first."""
    rows: list[Row] = []
    for delay_ms in delays_ms or DELAYS_ms:
        summary, rates = fly(folder / f"{delay_ms:g}", delay_ms)
        rows.append((f"{delay_ms:g}", *told(summary), f"{rates['up']:.2f}", f"{rates['down']:.2f}"))
    columns = ("delay ms", "ok", "mean error cm", "max cm", "hand force max N", "guiding s", "up Mbit/s", "down Mbit/s")
    return "the experiment over the radio (up: drone to ground)", columns, rows


def fly(folder: Path, delay_ms: float) -> tuple[dict[str, Any], dict[str, float]]:
    """One flight; its summary, and what crossed the radio from take-off to landing."""
    folder.mkdir(parents=True)
    # So slow a radio is refused as it is: connecting takes eight round trips, and clocks are known to half of one.
    radio = f"connect_s = {max(0.4, 0.03 * delay_ms)}\n"
    extra = f"[safety_supervisor.limits]\nclock_uncertainty_max_s = {max(0.05, 0.002 * delay_ms)}\n"
    with up(folder, radio, extra) as hosts:
        hosts.shape(**QUIET | {"delay_ms": delay_ms})
        hosts.clew("drone", "up", str(folder / "drone.toml"), "--out", str(folder / "onboard"))
        began, before = time.monotonic(), hosts.shape()
        profile, out = str(folder / "ground.toml"), str(folder / "sessions")
        demo = hosts.clew("ground", "demo", "--profile", profile, "--no-live", "--out", out)
        demo.communicate(timeout=200.0)
        took, after = time.monotonic() - began, hosts.shape()
        hosts.processes.remove(demo)
        for process in hosts.processes:
            stop(process)
        rates = {way: (after[f"{way}_bytes"] - before[f"{way}_bytes"]) * 8e-6 / took for way in ("up", "down")}
        return json.loads((folder / "sessions" / "latest" / "summary.json").read_text()), rates


def bandwidth(folder: Path) -> tuple[str, Row, list[Row]]:
    """By topic, from the ground's recording: payloads as they are said, before compression and what TLS and TCP add."""
    session, config = read(folder / "sessions" / "latest" / "session.mcap"), load(str(folder / "ground.toml"))
    onboard = set(config.hosts["drone"].services)
    rows: list[tuple[float, Row]] = []
    for topic in TOPICS:
        up, down = topic.publisher in onboard, topic.publisher not in onboard and bool(onboard & set(topic.subscribers))
        log = session.logs.get(topic.key)
        if log and (up or down):
            rate_Hz = len(log.payloads) / session.duration_s
            size = sum(map(len, log.payloads)) / len(log.payloads)
            kbit_s = 8e-3 * rate_Hz * size
            way = "up" if up else "down"
            rows.append((kbit_s, (topic.key, way, f"{rate_Hz:.1f}", f"{size:.0f}", f"{kbit_s:.0f}")))
    columns = ("topic", "way", "Hz on the radio", "bytes", "kbit/s")
    return "what crosses the radio", columns, [row for _, row in sorted(rows, reverse=True)]


def told(summary: dict[str, Any]) -> Row:
    """The paper's numbers of a flight."""

    def cm(value: float | None) -> str:
        return "–" if value is None else f"{value * 100:.1f}"

    force = summary["hand_force"]["max_n"]
    return (
        "yes" if summary["ok"] else "; ".join(summary["reasons"])[:60],
        cm(summary["path_error"]["mean_m"]),
        cm(summary["path_error"]["max_m"]),
        "–" if force is None else f"{force:.1f}",
        f"{summary['durations_s'].get('guiding', 0.0):.0f}",
    )


BENCHES = {"latency": latency, "outage": outage, "restarts": restarts}

if __name__ == "__main__":
    sys.exit(main())
