"""The energy that goes through the admittance filter: what each port supplies, what damping takes, what is left over.

| paper | here | unit | frame |
|---|---|---|---|
| ½ v_Rᵀ M_A v_R of the filter | kinetic, Balance.stored_J | J | W |
| u_A,xyᵀ v_R | Flow.guidance_J, its integral | J | W |
| u_A,z v_R,z | Flow.height_J | J | W |
| -f̂_cᵀ v_R | Flow.cable_J | J | W |
| the push of a hand that is near (leash.py), times v_R | Flow.hand_J | J | W |
| v_Rᵀ B_A v_R | Flow.dissipated_J | J | W |

The filter M_A v̇ = -B_A v - f̂_c + u_A has the storage ½ v ᵀM_A v, and u_A, springs included, is what its two other ports put
in (G11). Over a step of dt, in which f̂_c is held and the springs are linear or constant (admittance.py), with the
displacement Δp:

    Δ(½ vᵀM_A v) <= u_A(0)ᵀ Δp - f̂_cᵀ Δp - Δpᵀ B_A Δp / dt

because a spring that is stretched by Δp gives ½ k Δp² less than its first force would, the mean of v² is at least the square
of its mean, and the ceiling only takes kinetic energy. So the balance closes on one side exactly, to rounding, for every
dt: a step that creates energy is a fault, however small the step. On the other side the residual is what the ceiling took,
½ k Δp² and a² b dt³/12 a step: first order in dt as a sum. Broadcasts over leading axes.
"""

from typing import NamedTuple

from services.physics import Array, Components, Scalar, at_least, components

ROUNDING_J = 1e-9
"""What the books may seem to have made out of nothing; more is a fault."""


class Flow(NamedTuple):
    """What went through the ports in one step, in J, (...); guidance and height at most so much, damping at least."""

    guidance_J: Scalar
    height_J: Scalar
    cable_J: Scalar
    dissipated_xy_J: Scalar
    dissipated_z_J: Scalar
    hand_J: Scalar = 0.0


class Balance(NamedTuple):
    """Sums of a flight in J, (...). `handed_J`: kinetic energy that position mode handed over, less what it took back.

    stored = handed + guidance + height + cable + hand - dissipated - residual. `created_J` adds up only the steps that ended
    with more than they were given: 0 to rounding, unless the filter is not what it should be.
    """

    stored_J: Scalar = 0.0
    handed_J: Scalar = 0.0
    guidance_J: Scalar = 0.0
    height_J: Scalar = 0.0
    cable_J: Scalar = 0.0
    dissipated_J: Scalar = 0.0
    created_J: Scalar = 0.0
    hand_J: Scalar = 0.0

    @property
    def residual_J(self) -> Scalar:
        """What left by neither port nor damping."""
        supplied = self.guidance_J + self.height_J + self.cable_J + self.hand_J
        return self.handed_J + supplied - self.dissipated_J - self.stored_J


def kinetic(v: Array, M_A_kg: float) -> Scalar:
    """½ M_A ‖v‖² in J, (...)."""
    x, y, z = components(v)
    return 0.5 * M_A_kg * (x * x + y * y + z * z)


def flow(p_before: Array, p_after: Array, u_A: Components, f_c: Array, b: Components, dt: Scalar) -> Flow:
    """Of a step of `dt` s from `p_before` to `p_after` (..., 3): u_A and f̂_c at its start in N, damping b in N s/m."""
    (x_0, y_0, z_0), (x_1, y_1, z_1), (f_x, f_y, f_z) = components(p_before), components(p_after), components(f_c)
    x, y, z = x_1 - x_0, y_1 - y_0, z_1 - z_0
    return Flow(
        guidance_J=u_A[0] * x + u_A[1] * y,
        height_J=u_A[2] * z,
        cable_J=-(f_x * x + f_y * y + f_z * z),
        dissipated_xy_J=(b[0] * x * x + b[1] * y * y) / dt,
        dissipated_z_J=b[2] * z * z / dt,
    )


def apart(through: Flow, push: Array, p_before: Array, p_after: Array) -> Flow:
    """Of a step in which the filter felt f̂_c less `push` (..., 3) N: what the cable passed, and what the hand did."""
    moved = zip(components(p_before), components(p_after), components(push), strict=True)
    hand_J = sum(f * (after - before) for before, after, f in moved)
    return through._replace(cable_J=through.cable_J - hand_J, hand_J=hand_J)


def add(balance: Balance, through: Flow, stored_J: Scalar) -> Balance:
    """The books after one step of the filter that ends with `stored_J` of kinetic energy."""
    lost = through.dissipated_xy_J + through.dissipated_z_J
    supplied = through.guidance_J + through.height_J + through.cable_J + through.hand_J
    excess = stored_J - balance.stored_J - (supplied - lost)
    return Balance(
        stored_J,
        balance.handed_J,
        balance.guidance_J + through.guidance_J,
        balance.height_J + through.height_J,
        balance.cable_J + through.cable_J,
        balance.dissipated_J + lost,
        balance.created_J + at_least(excess, 0.0),
        balance.hand_J + through.hand_J,
    )


def hand_over(balance: Balance, stored_J: Scalar) -> Balance:
    """The books after something else than the filter moved the reference, which ends with `stored_J`."""
    return balance._replace(stored_J=stored_J, handed_J=balance.handed_J + stored_J - balance.stored_J)
