"""The energy that went through the admittance filter, so that its passivity can be watched."""

from schemas.message import Message, Vec3


class EnergyBalance(Message):
    """Sums since the bridge began to send set-points, at the filter's ports, with the estimated force f̂_c.

    stored = handed + guidance + height + cable + hand - dissipated - residual; what each is, and why the residual never falls
    while the filter is passive, stands in services/px4_bridge/energy.py.
    """

    stored_J: float
    """Kinetic energy of the virtual mass."""
    handed_J: float
    """Kinetic energy that position mode handed to the filter, less what it took back."""
    guidance_J: float
    """By all of u_A,xy, the spring included: what the tank pays."""
    height_J: float
    """By u_A,z: the vertical pull, the handle's weight, the spring that holds the height."""
    cable_J: float
    """By -f̂_c: negative where the robot worked on the person."""
    hand_J: float
    """By the push of a hand that comes near the vehicle; it feels nothing of it, so no port of a person pays."""
    dissipated_J: float
    residual_J: float
    """Lost by neither port nor damping: at the ceiling, and the discretisation's share."""
    created_J: float
    """Sum of what steps ended with beyond what they were given: 0 to rounding."""
    tank_J: float
    """What guidance may still spend."""
    tank_scale: float
    """Part of u_A,xy that the tank lets act: 1 unless it is nearly empty."""
    damping_Ns_per_m: Vec3
    """Of the filter, by axes; 0 where it does not fly."""
