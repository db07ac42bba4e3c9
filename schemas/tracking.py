"""Motion capture: what a system sees, and what is made of it."""

from enum import StrEnum

from schemas.message import Message, Part, Quaternion, Vec3


class RigidBody(Part):
    """One tracked body; position and attitude mean nothing while it is not tracked."""

    tracked: bool
    position_m: Vec3 = Vec3()
    q_WB_wxyz: Quaternion = Quaternion()


class StampedBy(StrEnum):
    """Whose clock said when a frame was true."""

    SOURCE = "source"  # the capture system's own, brought to this host's clock by its fastest frames
    ARRIVAL = (
        "arrival"  # nobody's: the frame arrived then, and is older by what the capture system and its network took
    )


class MocapFrame(Message):
    """One frame of the motion-capture system, as its driver delivers it: robot's centre of mass, and O_H."""

    robot: RigidBody
    handle: RigidBody
    stamped_by: StampedBy = StampedBy.SOURCE
    trouble: str = ""
    """What keeps a body away, in words, where the capture system or its driver tells."""


class RobotPose(Message):
    """Pose of the vehicle's centre of mass for the autopilot's estimator, jumps rejected."""

    position_m: Vec3
    q_WB_wxyz: Quaternion


class HandleSource(StrEnum):
    """Where the handle's position comes from."""

    MOCAP = "mocap"
    CABLE = "cable"  # from the robot and the cable force, while the handle is hidden
    NONE = "none"


HIDDEN = "handle hidden"
"""Thus begins the `invalid_reason` of a HandleState where no cause is known."""


class HandleState(Message):
    """p_H and v_H: the point O_H where the cable meets the handle. `lag_s` is the filter's delay on a constant velocity."""

    position_m: Vec3
    velocity_mps: Vec3
    source: HandleSource
    lag_s: float
