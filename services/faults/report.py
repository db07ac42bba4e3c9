"""The campaign for people: a table on the terminal, the table of the documentation, and a time line of one fault."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from services.faults.fault import Fault
from services.faults.measure import Result
from services.faults.promises import CALM_N, FORCE_N, TIP_M
from services.faults.record import NEVER, Record
from services.physics import norm
from services.rehearsal.chain import Flight

TABLE = ("<!-- clew faults: begin -->", "<!-- clew faults: end -->")
PX4_TABLE = ("<!-- clew faults on px4: begin -->", "<!-- clew faults on px4: end -->")
"""Between what the tables of the documentation are."""
HEAD = (
    "| fault | runs | must lead to | promised s | measured s | commanded N | pull after it N | tip to hand m | tip to head m | kept |",
    "|---|---|---|---|---|---|---|---|---|---|",
)


def table(results: Iterable[Result]) -> Table:
    """One row for each fault."""
    shown = Table(
        "fault",
        "must lead to",
        "promised s",
        "measured s",
        "commanded N",
        "pull N",
        "after it N",
        "hand m",
        "head m",
        "level",
        "verdict",
    )
    for r in results:
        verdict = f"[{'dim' if r.not_flown else 'green' if r.ok else 'red'}]{r.verdict}[/]"
        if r.exempt:
            verdict += f" [dim]but: {'; '.join(r.exempt)}[/]"
        shown.add_row(
            r.name,
            r.reaction,
            _promised(r.within_s),
            _time(r),
            f"{r.commanded_before_N:.1f} > {r.commanded_N:.1f}",
            f"{r.pull_before_N:.1f} > {r.pull_N:.1f}",
            f"{r.pull_after_ease_N:.2f}",
            _metres(r.tip_hand_m),
            _metres(r.tip_head_m),
            r.level,
            verdict,
        )
    return shown


def written(faults: Sequence[Fault], results: Sequence[Result]) -> list[str]:
    """The lines of the documentation's table: faults of one family in one row, the worst of each number."""
    families: dict[str, list[tuple[Fault, Result]]] = {}
    for fault, result in zip(faults, results, strict=True):
        families.setdefault(fault.family, []).append((fault, result))
    return [*HEAD, *map(_row, families.values())]


def _row(family: list[tuple[Fault, Result]]) -> str:
    fault, results = family[0][0], [result for _, result in family]
    timed = [r for r in results if r.within_s] or results
    worst = max(timed, key=lambda r: r.reaction_s / r.within_s if r.within_s else 0.0)
    if left := [r.not_flown for r in results if r.not_flown]:
        return f"| {fault.family} | 0 | {worst.reaction} | {_promised(worst.within_s)} {'| - ' * 5}| not flown: {left[0]} |"
    cells = (
        fault.family,
        str(len(results)),
        worst.reaction,
        _promised(worst.within_s),
        _time(worst),
        f"{max(r.commanded_N for r in results):.1f}",
        f"{max(r.pull_after_ease_N for r in results):.1f}",
        _metres(min(r.tip_hand_m for r in results)),
        _metres(min(r.tip_head_m for r in results)),
        _kept(results),
    )
    return f"| {' | '.join(cells)} |"


def _kept(results: Sequence[Result]) -> str:
    broken, exempt = [b for r in results for b in r.broken], any(r.exempt for r in results)
    return "**no**: " + broken[0] if broken else "yes, but see below" if exempt else "yes"


def insert(text: str, lines: Sequence[str], place: tuple[str, str] = TABLE) -> str:
    """`text` with `lines` between the markers. Raises ValueError where it has none."""
    begin, end = place
    before, found, rest = text.partition(begin)
    _, closed, after = rest.partition(end)
    if not found or not closed:
        raise ValueError(f"no {begin} and {end} in it")
    return "\n".join([before + begin, *lines, end + after])


def _promised(within_s: float) -> str:
    return f"{within_s:g}" if within_s else "-"


def _time(r: Result) -> str:
    if not r.within_s:
        return "-"
    return "never" if r.reaction_s == NEVER else f"{r.reaction_s:.2f}"


def _metres(m: float) -> str:
    return "-" if m == NEVER else f"{m:.2f}"


def pictures(folder: Path) -> Callable[[Fault, Flight, float], None]:
    """What draws a fault's time line into `folder`."""
    return lambda fault, flight, begin_s: picture(fault, flight, begin_s, folder)


def picture(fault: Fault, flight: Flight, begin_s: float, folder: Path) -> None:
    """The time line of one fault: forces, distances, heights, and who said what."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    r = Record(flight, begin_s)
    figure, (force, distance, height, words) = plt.subplots(4, 1, figsize=(9, 10), sharex=True, layout="constrained")
    force.plot(r.truth_s, r.pull_N, label="pull of the cable on the hand")
    force.plot(r.sent_s, r.u_A_N, label="commanded, ‖u_A‖")
    force.axhline(FORCE_N, color="red", lw=0.5)
    force.axhline(CALM_N, color="red", lw=0.5, ls=":")
    tip_m = flight.config.safety_supervisor.envelope.rotor_tip_m
    for of in ("hand", "head"):
        apart = [norm(m.robot_position_m.array() - getattr(m, f"{of}_position_m").array()) - tip_m for m in r.truth]
        distance.plot(r.truth_s, apart, label=f"rotor tip to {of}")
    distance.axhline(TIP_M, color="red", lw=0.5)
    height.plot(r.truth_s, [m.robot_position_m.z for m in r.truth], label="vehicle")
    height.plot(r.truth_s, [m.hand_position_m.z for m in r.truth], label="hand")
    for row, (times, said) in enumerate(
        (
            (r.sent_s, [m.kind for m in r.sent]),
            (r.state_s, [m.phase for m in r.states]),
            (r.state_s, [m.level.name.lower() for m in r.states]),
            _in_steps(r),
        )
    ):
        _words(words, row, times, said)
    words.set(
        yticks=range(4),
        yticklabels=["set-points", "phase", "level", "autopilot"],
        ylim=(3.6, -0.6),
        xlabel="s after the fault",
    )
    for axes, unit in ((force, "N"), (distance, "m"), (height, "m")):
        axes.set_ylabel(unit)
        axes.legend(loc="upper right")
    for axes in (force, distance, height, words):
        axes.axvline(0.0, color="black", lw=0.8)
    force.set(title=f"{fault.name}: {fault.about}", xlim=(-1.5, fault.watch_s))
    figure.savefig(folder / f"{fault.name}.png", dpi=90)  # pyright: ignore[reportUnknownMemberType]


def _in_steps(r: Record) -> tuple[np.ndarray, list[str]]:
    """The autopilot's mode, which is told where it changes, until the end."""
    words = [mode.value if armed else "disarmed" for _, mode, armed in r.modes]
    return np.array([*(t for t, _, _ in r.modes), r.truth_s[-1]]), [*words, *words[-1:]]


def _words(axes: object, row: int, times: np.ndarray, said: Sequence[object]) -> None:
    """Each stretch of the same word as a bar with the word in it."""
    begin = 0
    for n in range(1, len(said) + 1):
        if n == len(said) or said[n] != said[begin]:
            width = float(times[min(n, len(said) - 1)] - times[begin])
            axes.barh(row, width, left=float(times[begin]), height=0.8, alpha=0.3)  # pyright: ignore
            if width > 0.2 and times[begin] + width > -1.5:
                axes.text(max(float(times[begin]), -1.5), row, f" {said[begin]}", va="center", fontsize=7)  # pyright: ignore
            begin = n
