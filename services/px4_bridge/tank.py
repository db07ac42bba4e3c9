"""The energy tank: guidance may spend what is in it, and nothing else, so that the filter stays passive at the cable.

| paper (G11) | here | unit | frame |
|---|---|---|---|
| T, energy in the tank | State.level_J | J | |
| α, part of u_A,xy that may act | State.scale | | |
| u_A,xy, the whole horizontal part, spring included | wanted | N | W |
| v_R of the filter's reference | admittance.State.v | m/s | W |

Guidance is not a function of the robot's state (G3): it follows the hand, and may jump. What it puts into the filter at the
port (u_A,xy, v_R) is therefore paid for from the tank; what the filter's horizontal damping takes, and what guidance
takes back when it brakes, goes into it, up to `capacity_J`:

    T' = min(T - α u_A,xy(0)ᵀ Δp + Δp_xyᵀ B_A Δp_xy / dt, capacity),    α = min(1, T / max(fade, W))

W = |u_A,xy| (|v| dt + (|u_A,xy| + |f̂_c|) dt²/(2 M_A)) is more than u_A,xy can do in the step: |Δp| is no more than the bracket
divided by |u_A,xy|, as damping and springs only shorten it. So α W <= T, T never falls below zero, and an empty tank
means u_A,xy = 0: neither pull nor spring. Nearly empty (T < fade) the force fades with a time constant of fade over
power, so that nobody feels a step.

With energy.py's inequality by axes (they are coupled only by this scale): storage S = ½ v_xyᵀ M_A v_xy + T has

    ΔS <= -f̂_c,xyᵀ Δp_xy

for every command, every change of commands, every dt and every f̂_c: the filter with its tank is passive at the cable's port.
The vertical part, f_z or the handle's weight and K_z, is not scaled (empty must not mean that the vehicle sinks onto the
person); it is a potential for as long as a command lasts, and its supply is metered as `height_J`. A charge is given
where the filter is engaged from position mode, that is once a walk, by a person's word. Broadcasts over leading axes.
"""

from typing import NamedTuple

from services.parameters import Positive, parameters
from services.physics import Array, Components, Scalar, at_least, clamp, components
from services.px4_bridge import admittance, energy
from services.px4_bridge.admittance import Admittance, Command
from services.px4_bridge.energy import Flow


@parameters
class Tank:
    """What one walk may take out of the guidance, and below which level the force fades."""

    capacity_J: Positive
    fade_J: Positive


class State(NamedTuple):
    """Level in J and the part of u_A,xy that acted in the last step, (...)."""

    level_J: Scalar
    scale: Scalar


def charged(p: Tank) -> State:
    """Full."""
    return State(p.capacity_J, 1.0)


def step(
    state: State,
    reference: admittance.State,
    f_c: Array,
    c: Command,
    slack: Scalar,
    dt: Scalar,
    z_max_m: float,
    p: Admittance,
    tank: Tank,
) -> tuple[State, admittance.State, Array, Flow]:
    """`admittance.step` behind the tank: both states, u_A at the new reference (..., 3), and what the ports passed."""
    wanted = components(admittance.u_A(reference.p, c, p))
    part = _part(state.level_J, wanted, components(reference.v), components(f_c), dt, p.M_A_kg, tank.fade_J)
    after, u_A = admittance.step(reference, f_c, c._replace(scale=c.scale * part), slack, dt, z_max_m, p)
    acted = (part * wanted[0], part * wanted[1], wanted[2])
    through = energy.flow(reference.p, after.p, acted, f_c, admittance.damping(after, c, p), dt)
    level = state.level_J - through.guidance_J + through.dissipated_xy_J
    return State(clamp(level, 0.0, tank.capacity_J), part), after, u_A, through


def _part(
    level_J: Scalar, u_A: Components, v: Components, f_c: Components, dt: Scalar, M_A_kg: float, fade_J: float
) -> Scalar:
    """α: all of u_A,xy while the tank holds more than `fade_J` and than the step can take; else in proportion."""
    force = (u_A[0] * u_A[0] + u_A[1] * u_A[1]) ** 0.5
    felt = (f_c[0] * f_c[0] + f_c[1] * f_c[1]) ** 0.5
    speed = (v[0] * v[0] + v[1] * v[1]) ** 0.5
    worst = force * dt * (speed + (force + felt) * dt / (2.0 * M_A_kg))
    return clamp(level_J / at_least(worst, fade_J), 0.0, 1.0)
