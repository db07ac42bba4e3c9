# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# matplotlib's stubs leave keyword arguments open
"""The stability map as a figure: for each vehicle, observer and delay the grid of cells, and Re Y(jω) beside it."""

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from services.campaign import stability
from services.campaign.stability import Flown

TICKS_HZ = (0.5, 1, 2, 4, 8)


def draw(maps: Sequence[Flown], file: Path) -> None:
    """A row for each map, observer and delay; numbers in brackets were measured on real PX4."""
    rows = [(m, o, d) for m in maps for o, d in product(range(len(m.grid.observer_Hz)), range(len(m.grid.delay_ms)))]
    figure: Any = Figure(figsize=(12, 4.2 * len(rows)), layout="constrained")
    for (cells, curves), (flown, observer, delay) in zip(
        figure.subplots(len(rows), 2, squeeze=False), rows, strict=True
    ):
        _cells(cells, flown, observer, delay)
        _curves(curves, flown, observer, delay)
    figure.savefig(file, dpi=120)


def _cells(axes: Any, m: Flown, observer: int, delay: int) -> None:
    std = m.tension.std_N[:, :, observer, delay]
    axes.imshow(np.log10(np.maximum(std, 1e-2)), cmap="RdYlGn_r", vmin=-1.7, vmax=0.7, aspect="auto", alpha=0.6)
    late, seen = m.grid.delay_ms[delay], m.grid.observer_Hz[observer]
    axes.set(
        title=f"{m.mass_kg:g} kg, observer {seen:g} Hz, {late:g} ms each way, lead {m.lead_s:g} s:\ntension std in N (real PX4)",
        xlabel="k_c in N/m",
        ylabel="M_A/m_R",
    )
    axes.set_xticks(range(len(m.grid.k_c_N_per_m)), [f"{k:g}" for k in m.grid.k_c_N_per_m])
    axes.set_yticks(range(len(m.grid.ratio)), [f"{r:g}" for r in m.grid.ratio])
    for (i, j), value in np.ndenumerate(std):
        real = stability.measured(m, i, j, delay)
        axes.text(j, i, f"{value:.2f}" + (f" ({real:g})" if np.isfinite(real) else ""), ha="center", va="center")


def _curves(axes: Any, m: Flown, observer: int, delay: int) -> None:
    for ratio, row in zip(m.grid.ratio, m.port.Y_mps_per_N[:, observer, delay].real, strict=True):
        axes.semilogx(m.port.frequency_Hz, row, label=f"M_A/m_R = {ratio:g}")
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.set(title="admittance at the cable port", xlabel="frequency in Hz", ylabel="Re Y in m/s/N", ylim=(-0.03, 0.12))
    axes.set(xticks=TICKS_HZ, xticklabels=[f"{f:g}" for f in TICKS_HZ])
    axes.minorticks_off()
    axes.legend(fontsize="small")
