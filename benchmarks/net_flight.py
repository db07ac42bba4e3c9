"""The experiment of `make demo`, flown over the radio between two hosts, and what that costs the radio."""

import json
import time
from pathlib import Path
from typing import Any

from benchmarks.two_hosts import QUIET, Row, up
from schemas.topics import TOPICS
from services.config import load
from services.recorder.reading import read

DELAYS_ms = [0.0, 20.0, 200.0]
FLIGHT_MAX_s, WINDOW_s = 200, 10
WAYS, LINKS, CARRIED = ("up", "down"), ("guidance", "guidance, every other", "samples, states", "bulk"), "carried.json"
Carried = dict[str, dict[str, list[int]]]
"""As the radio counts it: by way and port, packets and bytes."""


def flight(folder: Path, delays_ms: list[float]) -> tuple[str, Row, list[Row]]:
    """The experiment of `make demo`, split over two hosts; one flight for each delay, and without a delay first."""
    rows: list[Row] = []
    for delay_ms in delays_ms or DELAYS_ms:
        summary, carried = fly(folder / f"{delay_ms:g}", delay_ms)
        (folder / f"{delay_ms:g}" / CARRIED).write_text(json.dumps(carried))
        rows.append((f"{delay_ms:g}", *told(summary), *(f"{Mbit_s(busiest(carried, way)):.2f}" for way in WAYS)))
    columns = ("delay ms", "ok", "mean error cm", "max cm", "hand force max N", "guiding s", "up Mbit/s", "down Mbit/s")
    return f"the experiment over the radio (up: drone to ground, in its busiest {WINDOW_s} s)", columns, rows


def fly(folder: Path, delay_ms: float) -> tuple[dict[str, Any], list[Carried]]:
    """One flight; its summary, and what the radio had carried at each second of it."""
    folder.mkdir(parents=True)
    # So slow a radio is refused as it is: connecting takes eight round trips, and clocks are known to half of one.
    radio = f"connect_s = {max(0.4, 0.03 * delay_ms)}\n"
    extra = f"[safety_supervisor.limits]\nclock_uncertainty_max_s = {max(0.05, 0.002 * delay_ms)}\n"
    with up(folder, radio, extra) as hosts:
        hosts.shape(**QUIET | {"delay_ms": delay_ms})
        hosts.clew("drone", "up", str(folder / "drone.toml"), "--out", str(folder / "onboard"))
        profile, out = str(folder / "ground.toml"), str(folder / "sessions")
        demo = hosts.clew("ground", "demo", "--profile", profile, "--no-live", "--out", out)
        carried = [hosts.shape()]
        while demo.poll() is None and len(carried) < FLIGHT_MAX_s:
            time.sleep(1.0)
            carried.append(hosts.shape())
        return json.loads((folder / "sessions" / "latest" / "summary.json").read_text()), carried


def between(before: Carried, after: Carried, way: str) -> dict[str, list[int]]:
    """What was carried meanwhile."""
    counts = {port: (before[way].get(port, [0, 0]), now) for port, now in after[way].items()}
    return {port: [b - a for a, b in zip(*pair, strict=True)] for port, pair in counts.items()}


def busiest(carried: list[Carried], way: str) -> dict[str, list[int]]:
    """In the WINDOW_s that had most."""
    windows = [between(*pair, way) for pair in zip(carried, carried[WINDOW_s:], strict=False)]
    return max(windows, key=Mbit_s)


def Mbit_s(window: dict[str, list[int]]) -> float:
    """Of all links together."""
    return sum(size for _, size in window.values()) * 8e-6 / WINDOW_s


def by_link(carried: list[Carried]) -> tuple[str, Row, list[Row]]:
    """Whole packets, with all that QUIC, TLS, TCP and IP add and answer."""
    radio = load("drone-sim").radio
    assert radio
    ports = dict(zip(map(str, radio.ports), LINKS, strict=True))
    rows = [
        (name, way, f"{busy[port][0] / WINDOW_s:.0f}", f"{busy[port][1] * 8e-3 / WINDOW_s:.0f}")
        for way in WAYS
        for busy in (busiest(carried, way),)
        for port, name in ports.items()
    ]
    return f"what each link carries in the busiest {WINDOW_s} s", ("link", "way", "packets/s", "kbit/s"), rows


def by_topic(folder: Path) -> tuple[str, Row, list[Row]]:
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
