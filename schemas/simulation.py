"""What only a simulator knows."""

from schemas.message import Message, Quaternion, Vec3


class Truth(Message):
    """The simulated world as it is, for reports and tests; no service that flies listens to it."""

    robot_position_m: Vec3
    robot_velocity_mps: Vec3
    robot_q_WB_wxyz: Quaternion
    hand_position_m: Vec3
    hand_velocity_mps: Vec3
    handle_position_m: Vec3
    handle_velocity_mps: Vec3
    head_position_m: Vec3
    cable_force_N: Vec3
    """On the handle, towards the robot."""
    hand_force_N: Vec3
    """On the hand: the cable's pull less the handle's weight; zero while the handle is not held."""
    holding: bool
    subject: str
    """What the simulated person is doing."""
