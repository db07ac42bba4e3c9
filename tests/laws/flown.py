"""The bridge's law as its tests fly it: one set of parameters, what it is told, and how time passes."""

from collections.abc import Iterator

import numpy as np

from schemas.safety import Permit
from services import cable
from services.physics import Array
from services.px4_bridge import flight
from services.px4_bridge.approach import Approach
from services.px4_bridge.flight import Flight, Force, Guidance, Input, Output, Params, State
from services.px4_bridge.setpoint import Limits
from tests.laws import ideal

P = Params(
    Flight(
        m_R_kg=0.8,
        handle_weight_N=0.3,
        rest_length_m=1.0,
        ceiling_m=2.1,
        feed_forward_ramp_s=1.0,
        feed_forward_drop_s=0.2,
        lead_s=0.15,
        ease_slack_m=0.05,
        hand_clear_m=0.85,
        follow_mps=1.0,
        yaw_rad=0.0,
    ),
    ideal.FILTER,
    Approach(a_max_mps2=0.8, rate_per_s=1.0),
    Limits(a_xy_max_mps2=5.0, a_z_max_mps2=4.0, v_max_mps=1.5, step_max_m=0.05),
    ideal.TANK,
)
DT = 0.008
ZERO = np.zeros(3)
HAND = np.array([0.0, 0.0, ideal.PLANE_Z])
WANTED = np.array([1.5, 0.0, 1.0])  # the paper's pull
LED = HAND + cable.offset(WANTED, ideal.CABLE)
START = np.array([-2.0, -0.5, 1.9])


def sight(permit: Permit, f_c: Array = ZERO, *, held: bool = True, fresh: bool = True, guided: bool = True) -> Input:
    """One tick with two force samples in it, or none where the force is stale."""
    forces = [Force(f_c, False, DT / 2)] * 2 if fresh else []
    guidance = Guidance(LED, WANTED, 1.0) if guided else None
    return Input(permit, START, 0.6, held, forces, fresh, guidance)


def fly(state: State, x: Input, seconds: float) -> Iterator[tuple[State, Output]]:
    for _ in range(round(seconds / DT)):
        state, output = flight.step(state, x, DT, P)
        yield state, output


def after(state: State, x: Input, seconds: float) -> State:
    *_, (state, _) = fly(state, x, seconds)
    return state


def guided(f_c: Array = WANTED) -> State:
    """In equilibrium, led by the paper's pull, everything ramped in."""
    return after(flight.initial(LED, P), sight(Permit.GUIDE, f_c), 1.5)
