"""Energy in a recorded session: the filter's own books, the same books with the true robot and force, and V of the walk.

The filter's are the bridge's (px4_bridge/energy.py, with f̂_c and the filter's reference). The physical ones ask the same
of the true motion and the true force, as if the vehicle were the filter: what does not add up there is what the vehicle
adds by lagging behind its reference and the observer by erring. V is the paper's, to the end of the path, in phase 2.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.safety import Phase
from schemas.topics import ENERGY, SETPOINT, TRUTH
from schemas.vehicle import SetpointKind
from services.cable import Cable, offset
from services.guiding_controller.path import Path
from services.physics import Array, Z
from services.px4_bridge import energy
from services.px4_bridge.energy import Balance
from services.recorder import lyapunov
from services.recorder.lyapunov import Regulation, States
from services.recorder.reading import Session
from services.recorder.table import Table, sample
from services.recorder.walk import config_of, path_of, within
from services.simulator import human


class Books(NamedTuple):
    """A balance over time: t_s (N,), every sum in it (N,); of length 0 where the recording does not tell."""

    t_s: Array
    balance: Balance


class Worst(NamedTuple):
    """How far a curve that should never fall has fallen over any stretch of time, and when it was lowest."""

    fall: float
    at_s: float


@dataclass(frozen=True, eq=False)
class Walk:
    """V of phase 2 while the handle is held, each (N,): observed and predicted rate in W, the sums in J.

    `unexplained_J` is V less what its predicted rate adds up to: 0 for the paper's ideal robot.
    """

    t_s: Array
    V_J: Array
    stored_J: Array
    observed_W: Array
    predicted_W: Array
    guidance_J: Array
    person_J: Array
    dissipated_J: Array
    unexplained_J: Array


def filter_books(session: Session) -> Books:
    """As the bridge kept them."""
    said = session.table(ENERGY)
    return Books(said["t_s"], Balance(*(said[name] for name in Balance._fields)))


def physical_books(session: Session) -> Books:
    """Where the filter flew, of the simulator's robot and cable: work by the mean force of each interval, as u_A changes."""
    seen = _seen(session)
    if seen is None:
        return Books(np.zeros(0), Balance(*np.zeros((len(Balance._fields), 0))))
    M_A = _parameter(session, "px4_bridge", "admittance")["M_A_kg"]
    flies, dt = seen.flies[:-1] & seen.flies[1:], np.diff(seen.t_s)
    u_A, f_c = _mean(seen.u_A), _mean(seen.f_c)
    through = energy.flow(seen.x.p_R[:-1], seen.x.p_R[1:], tuple(u_A.T), f_c, tuple(seen.b_A[1:].T), dt)
    guidance, height, cable, lost_xy, lost_z = (np.where(flies, x, 0.0) for x in through[:5])
    kinetic = energy.kinetic(seen.x.v_R, M_A)
    gained = np.diff(kinetic)
    excess = np.where(flies, gained, 0.0) - (guidance + height + cable - lost_xy - lost_z)
    sums = (np.where(flies, 0.0, gained), guidance, height, cable, lost_xy + lost_z, np.maximum(excess, 0.0))
    balance = Balance(kinetic, *(_summed(x) for x in sums))
    unfelt = np.zeros_like(kinetic)  # what a hand near the vehicle did by its push was done to the reference alone
    return Books(seen.t_s, balance._replace(handed_J=kinetic[0] + balance.handed_J, hand_J=unfelt))


def walk(session: Session) -> Walk | None:
    """V and what changes it; None without the simulator's truth, a path and a guided stretch in the recording."""
    seen, path = _seen(session), path_of(session)
    if seen is None or path is None:
        return None
    spans = [span for span in session.phases if span.phase in (Phase.GUIDING, Phase.ARRIVED)]
    chosen = within(seen.t_s, spans) & seen.held & seen.flies
    if np.sum(chosen) < 3:
        return None
    p, u_H = _regulation(session, path), _u_H(session, seen)
    V, extra = lyapunov.V(seen.x, p), lyapunov.exogenous(seen.u_A, seen.x.p_R, p)
    predicted = lyapunov.rate(seen.x, seen.b_A, seen.u_A, u_H, p)
    inside, dt = chosen[:-1] & chosen[1:], np.diff(seen.t_s)

    def energy_of(power_W: Array) -> Array:
        return _summed(np.where(inside, dt * _mean(power_W), 0.0))[chosen]

    return Walk(
        t_s=seen.t_s[chosen],
        V_J=V[chosen],
        stored_J=lyapunov.stored(seen.x, p)[chosen],
        observed_W=np.gradient(V, seen.t_s)[chosen],
        predicted_W=predicted[chosen],
        guidance_J=energy_of(np.sum(extra * seen.x.v_R, axis=-1)),
        person_J=energy_of(np.sum(u_H * seen.x.v_H, axis=-1)),
        dissipated_J=energy_of(lyapunov.dissipated(seen.x, seen.b_A, p).total_W),
        unexplained_J=_summed(np.where(inside, np.diff(V), 0.0))[chosen] - energy_of(predicted),
    )


def worst(t_s: Array, curve: Array) -> Worst:
    """The deepest fall of a curve (N,) from any earlier value; N is at least 1."""
    fall = np.maximum.accumulate(curve) - curve
    i = int(np.argmax(fall))
    return Worst(float(fall[i]), float(t_s[i]))


class _Seen(NamedTuple):
    """The simulator's truth, and what the filter was driven and damped with, at the truth's own times."""

    t_s: Array
    x: States
    f_c: Array
    held: NDArray[np.bool_]
    u_A: Array
    b_A: Array
    flies: NDArray[np.bool_]


def _seen(session: Session) -> _Seen | None:
    truth, sent, books = session.table(TRUTH), session.table(SETPOINT), session.table(ENERGY)
    if min(len(truth["t_s"]), len(sent["t_s"]), len(books["t_s"])) < 3:
        return None
    t = truth["stamp_ns"]  # not when it was heard: its own time is what its velocities belong to
    complies = (sent["kind"] != SetpointKind.POSITION)[:, None]
    latest = np.searchsorted(books["stamp_ns"], t, side="right") - 1
    b_A = np.where((latest >= 0)[:, None], books["damping_Ns_per_m"][latest], 0.0)
    return _Seen(
        t_s=1e-9 * (t - t[0]) + float(np.median(truth["t_s"] - 1e-9 * (t - t[0]))),
        x=_states(truth),
        f_c=truth["cable_force_N"],
        held=truth["holding"],
        u_A=sample(sent["stamp_ns"], sent["u_A_N"] * complies, t),
        b_A=b_A,
        flies=b_A[:, 0] > 0.0,
    )


def _states(truth: Table) -> States:
    names = ("hand_position_m", "hand_velocity_mps", "robot_position_m", "robot_velocity_mps")
    return States(*(truth[name] for name in names))


def _regulation(session: Session, path: Path) -> Regulation:
    """To the end of the path, where nothing pulls but f_z."""
    person, filt = _parameter(session, "person", "human"), _parameter(session, "px4_bridge", "admittance")
    cable = Cable(**config_of(session)["cable"])
    f_c_r = _parameter(session, "guiding_controller")["f_z_N"] * Z
    p_R_r = path.p(1.0) + offset(f_c_r, cable)
    return Regulation(
        person["m_H_kg"], person["b_H_Ns_per_m"], filt["M_A_kg"], filt["k_H_N_per_m"], cable, p_R_r, f_c_r
    )


def _u_H(session: Session, seen: _Seen) -> Array:
    """What the simulated person did of their own will, (N, 3): the script counts while they hold the handle."""
    person = _parameter(session, "person")
    body = human.Human(**person["human"])
    script = tuple(human.Event(**event) for event in person["behaviour"])
    force = np.zeros_like(seen.x.v_H)
    since = seen.t_s[np.maximum.accumulate(np.where(seen.held, 0, np.arange(len(seen.t_s))))]
    for i in np.flatnonzero(seen.held) if script else ():
        state = human.HumanState(seen.x.p_H[i], seen.x.v_H[i], Z)
        force[i] = human.u_H(float(seen.t_s[i] - since[i]), state, script, body)
    return force


def _parameter(session: Session, *keys: str) -> dict[str, Any]:
    found = config_of(session)
    for key in keys:
        found = found[key]
    return found


def _mean(x: Array) -> Array:
    """Of each interval between samples, (N - 1, ...)."""
    return 0.5 * (x[:-1] + x[1:])


def _summed(x: Array) -> Array:
    """Of the intervals up to each sample, (N,)."""
    return np.append(0.0, np.cumsum(x))
