"""Thrust and mass from a flight in which nothing pulls but gravity, and a known weight on the cable.

| symbol | here | unit | frame |
|---|---|---|---|
| specific force along the body's z | Flight.a_z | m/s² | B |
| cosine of the tilt | Flight.upright | | |
| means of the motors' shares, of their squares | Flight.mean, square | | |
| m_R, and what hangs on the cable | mass_kg, hanging_kg | kg | |

Along the body's z: m_R a_z + w cos(tilt) = T, with w the hanging weight. T is linear in two unknowns (px4_bridge/thrust.py), so
that a known mass gives them: a hover their sum, steps up and down each of them. The motors are behind what they are told, so
their shares go through a lag before they are compared; the lag and the voltage's exponent are those that leave the least. Means
over 0.2 s are fitted: what the observer's bias is made of, not its noise. Air drag is left out: 0.05 N at 0.5 m/s.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from services.calibration.fit import Fit, Unfit, lagged, least_squares, lowest, windows
from services.physics import GRAVITY_MPS2, Array

WINDOW_S = 0.2
SHORTEST_S = 3.0
LAGS_S = np.linspace(0.0, 0.15, 16)
EXPONENTS = np.linspace(0.0, 3.0, 13)
VOLTAGE_SPREAD = 0.03
"""Relative; with less, its exponent cannot be found and is taken as 0."""
CONDITION_MAX = 150.0
"""With more, thrust has changed by less than 2 % (rms), too little to show a curve: the profile's is kept, and scaled."""


class Flight(NamedTuple):
    """Even samples, `dt_s` apart; all (N,). Those that are not to be used keep the rest in step."""

    dt_s: float
    a_z: Array
    upright: Array
    mean: Array
    square: Array
    battery_V: Array
    use: NDArray[np.bool_]


class ThrustFit(NamedTuple):
    """The model of px4_bridge/thrust.py; `error` is the rms of what is left over the mean thrust."""

    max_thrust_N: float
    curve: float
    voltage_exponent: float
    reference_V: float
    lag_s: float
    error: float
    low_N: float
    high_N: float
    """Between which thrust has been seen: the 5th and 95th percentile."""
    kept_curve: bool
    """The curve is the given one, because thrust hardly changed."""
    fit: Fit


class MassFit(NamedTuple):
    """m_R in kg and the factor on the known thrust, 1 where it was taken as it is."""

    mass_kg: float
    scale: float
    fit: Fit


def thrust(flight: Flight, mass_kg: float, hanging_kg: float, curve: float = 0.0) -> ThrustFit:
    """The thrust model of a vehicle of known mass; `curve` is kept where the flight does not show one. Raises Unfit."""
    _long_enough(flight)
    force = _means(flight, mass_kg * flight.a_z + hanging_kg * GRAVITY_MPS2 * flight.upright)
    volts = _means(flight, flight.battery_V)
    reference_V = float(np.median(volts))
    relative = volts / reference_V if reference_V > 0.0 else np.ones_like(volts)

    def left(tau: float, k: float) -> float:
        return _model(flight, tau, force, relative, k, curve)[0].rms

    lag_s, k = lowest(partial(left, k=0.0), LAGS_S), 0.0
    if float(np.ptp(relative)) > VOLTAGE_SPREAD:
        k = lowest(partial(left, lag_s), EXPONENTS)
        lag_s = lowest(partial(left, k=k), LAGS_S)
    fit, kept = _model(flight, lag_s, force, relative, k, curve)
    whole = float(fit.x[0]) if kept else float(fit.x[0] + fit.x[1])
    found = curve if kept else float(fit.x[1]) / whole
    error = fit.rms / float(np.mean(force))
    low, high = np.percentile(force, (5.0, 95.0))
    return ThrustFit(whole, found, k, max(reference_V, 1e-3), lag_s, error, float(low), float(high), kept, fit)


def mass(flights: list[Flight], thrust_N: list[Array], added_kg: list[float], hanging_kg: float) -> MassFit:
    """m_R from one hover with a known thrust; or from several, with known masses fixed to the vehicle in some of them.

    `thrust_N` are the model's newtons of each flight, (N,). With several the model need only have the right shape: its scale
    is found beside the mass. Raises Unfit.
    """
    for flight in flights:
        _long_enough(flight)
    T = np.concatenate([_means(f, t) for f, t in zip(flights, thrust_N, strict=True)])
    a = np.concatenate([_means(f, f.a_z) for f in flights])
    pulled = np.concatenate([_means(f, hanging_kg * GRAVITY_MPS2 * f.upright) for f in flights])
    if len(set(added_kg)) < 2:
        fit = least_squares(a[:, None], T - pulled - added_kg[0] * a)
        return MassFit(float(fit.x[0]), 1.0, fit)
    added = np.concatenate([np.full(len(_means(f, f.a_z)), m) for f, m in zip(flights, added_kg, strict=True)])
    fit = least_squares(np.stack((T, -a), axis=1), added * a + pulled)
    return MassFit(float(fit.x[1]), float(fit.x[0]), fit)


def _model(flight: Flight, lag_s: float, force: Array, relative_V: Array, k: float, curve: float) -> tuple[Fit, bool]:
    """Fit of T_max (1 - c) and T_max c, or of T_max alone where the two look alike."""
    shares = lagged(np.stack((flight.mean, flight.square), axis=1), flight.dt_s, lag_s)
    u = _means(flight, shares) * (relative_V**k)[:, None]
    try:
        both = least_squares(u, force)
        if both.condition <= CONDITION_MAX:
            return both, False
    except Unfit:
        pass
    return least_squares(((1.0 - curve) * u[:, 0] + curve * u[:, 1])[:, None], force), True


def _means(flight: Flight, values: Array) -> Array:
    return windows(values, flight.use, max(round(WINDOW_S / flight.dt_s), 1))


def _long_enough(flight: Flight) -> None:
    seconds = float(np.count_nonzero(flight.use)) * flight.dt_s
    if seconds < SHORTEST_S:
        raise Unfit(f"{seconds:.1f} s of free flight, at least {SHORTEST_S:g} s are needed")
