"""PX4 in software as the vehicle's autopilot: how it is started, and the parameters that follow from the simulated vehicle.

| PX4 | here |
|---|---|
| CA_ROTOR*, MPC_THR_HOVER, THR_MDL_FAC | the body (quadrotor.py): where each motor stands and turns, and how strong it is |
| MPC_*, MC_* | the gains of the vehicle's file that the stand-in flies with too (cascade.py) |
| everything else | the profile |

PX4's axes are forward, right, down; a rotor that turns anticlockwise seen from above has a positive moment there.
"""

from collections.abc import Mapping
from typing import Annotated, TypeAlias

from annotated_types import Ge, Le

from services.parameters import Positive, parameters
from services.simulator.cascade import Cascade
from services.simulator.quadrotor import FORWARD, LEFT, SPIN, Quadrotor

Px4Parameters: TypeAlias = dict[str, int | float]

# The stand-in's roll_pitch_p_per_s is not here: it is fitted to PX4's response (the vehicle's file), PX4 keeps its own.
_GAINS = {
    "hover_thrust": ("MPC_THR_HOVER",),
    "thr_min": ("MPC_THR_MIN",),
    "thr_max": ("MPC_THR_MAX",),
    "thr_xy_margin": ("MPC_THR_XY_MARG",),
    "tilt_max_deg": ("MPC_TILTMAX_AIR",),
    "xy_p_per_s": ("MPC_XY_P",),
    "z_p_per_s": ("MPC_Z_P",),
    "xy_vel_p_per_s": ("MPC_XY_VEL_P_ACC",),
    "xy_vel_i_per_s2": ("MPC_XY_VEL_I_ACC",),
    "xy_vel_d": ("MPC_XY_VEL_D_ACC",),
    "z_vel_p_per_s": ("MPC_Z_VEL_P_ACC",),
    "z_vel_i_per_s2": ("MPC_Z_VEL_I_ACC",),
    "z_vel_d": ("MPC_Z_VEL_D_ACC",),
    "roll_pitch_rate_p_s": ("MC_ROLLRATE_P", "MC_PITCHRATE_P"),
    "roll_pitch_rate_i": ("MC_ROLLRATE_I", "MC_PITCHRATE_I"),
    "roll_pitch_rate_d_s2": ("MC_ROLLRATE_D", "MC_PITCHRATE_D"),
    "yaw_rate_p_s": ("MC_YAWRATE_P",),
    "yaw_rate_i": ("MC_YAWRATE_I",),
}


@parameters
class Px4Sitl:
    """Which PX4, and how long it may take to come."""

    binary: str
    """The program; empty: somebody else starts it."""
    instance: Annotated[int, Ge(0), Le(9)]
    """PX4's own numbering: it moves the simulator's port (4560) and the companion's (14540)."""
    airframe: str
    appears_s: Positive
    parameters: Px4Parameters
    """What only the simulation sets; the vehicle's and the laboratory's come before."""
    radio_control: bool = False
    """Whether a pilot's is there. PX4 heeds it where COM_RC_IN_MODE lets it."""

    @property
    def port(self) -> int:
        """Where PX4 looks for its simulator."""
        return 4560 + self.instance

    @property
    def system(self) -> int:
        """Its number in MAVLink."""
        return 1 + self.instance

    @property
    def station_port(self) -> int:
        """Where PX4 listens for a ground station."""
        return 18570 + self.instance


def of_vehicle(body: Quadrotor, gains: Cascade) -> Px4Parameters:
    """Geometry, thrust and gains for PX4's mixer and controllers."""
    found: Px4Parameters = {"CA_ROTOR_COUNT": 4, "THR_MDL_FAC": 0.0}
    for n, (forward, left, spin) in enumerate(zip(FORWARD, LEFT, SPIN, strict=True)):
        found[f"CA_ROTOR{n}_PX"] = round(float(forward) * body.arm_length_m, 6)
        found[f"CA_ROTOR{n}_PY"] = round(float(-left) * body.arm_length_m, 6)
        found[f"CA_ROTOR{n}_KM"] = float(-spin) * body.torque_per_thrust_m
    for ours, theirs in _GAINS.items():
        for name in theirs:
            found[name] = getattr(gains, ours)
    return found


def environment(parameters: Mapping[str, int | float], airframe: str) -> dict[str, str]:
    """How PX4's start script is told."""
    return {"PX4_SIM_MODEL": airframe} | {f"PX4_PARAM_{name}": f"{value}" for name, value in parameters.items()}
