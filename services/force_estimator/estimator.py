"""The estimator as a whole: observer, tare and watch, one IMU sample at a time.

| paper | here | unit | frame |
|---|---|---|---|
| f̂_c as observed | Estimate.observed | N | W |
| f̂_c free of bias | Estimate.f_c | N | W |
| l_c = p_R - p_H by motion capture | Geometry.l_c | m | W |

Zeroing (tare) runs while it is asked for, in hover, with the handle hanging; its result stays until the next (G8).
"""

from typing import NamedTuple

import numpy as np

from schemas.estimation import Tare
from services.force_estimator import bias, observer
from services.force_estimator.bias import Bias
from services.force_estimator.observer import Observer
from services.physics import Array, norm


class Sample(NamedTuple):
    """One inertial sample: specific force (3,) m/s² in B, attitude (4,), thrust N, and the time since the last one."""

    a_B: Array
    q_WB_wxyz: Array
    thrust_N: float
    dt_s: float


class Geometry(NamedTuple):
    """The cable by motion capture; `seen` says whether both ends are."""

    l_c: Array
    seen: bool
    held: bool


class State(NamedTuple):
    """Observer, running tare, its result, and what has changed since."""

    observer: observer.State
    running: bias.TareState | None
    tare: Tare
    report: str
    zero: Array
    change: Array


class Estimate(NamedTuple):
    """f̂_c with and without bias, (3,) N; `slack_m` is l̄ - ‖l_c‖ where both ends are seen, else -1."""

    f_c: Array
    observed: Array
    taut: bool
    slack_m: float


def initial() -> State:
    """Never zeroed."""
    return State(observer.start(), None, Tare.NONE, "", np.zeros(3), np.zeros(3))


def step(
    state: State, x: Sample, cable: Geometry, zero_now: bool, rest_length_m: float, o: Observer, b: Bias
) -> tuple[State, Estimate]:
    """One sample; `zero_now` is the supervisor's wish to tare, a level."""
    filtered, observed = observer.step(state.observer, x.a_B, x.q_WB_wxyz, x.thrust_N, x.dt_s, o)
    state = _zeroing(state._replace(observer=filtered), observed, zero_now, x.dt_s, b)
    since = observed - state.zero
    if state.tare is Tare.PASSED:
        change = bias.watch(state.change, since, cable.l_c, cable.seen, cable.held, x.dt_s, rest_length_m, b)
        state = state._replace(change=change)
    slack_m = rest_length_m - float(norm(cable.l_c)) if cable.seen else -1.0
    f_c = since - state.change
    return state, Estimate(f_c, observed, bool(norm(f_c) > b.handle_weight_N / 2), slack_m)


def _zeroing(state: State, observed: Array, zero_now: bool, dt_s: float, p: Bias) -> State:
    """Start, go on, finish: the result is judged once the time is full, and kept while the wish lasts."""
    if not zero_now:
        return state._replace(running=None, tare=Tare.NONE if state.tare is Tare.RUNNING else state.tare)
    if state.running is None:
        fresh = bias.tare_start()
        return state._replace(running=fresh, tare=Tare.RUNNING, report="", change=np.zeros(3))
    if state.tare is not Tare.RUNNING:
        return state
    running = bias.tare_step(state.running, observed, dt_s)
    state = state._replace(running=running)
    if running.t_s < p.tare_s:
        return state
    result = bias.tare_result(running, p)
    verdict = Tare.FAILED if result.reason else Tare.PASSED
    zero = state.zero if result.reason else result.bias
    return state._replace(tare=verdict, report=result.reason, zero=zero)
