"""What the guiding controller asks of the admittance filter."""

from schemas.message import Message, Vec3


class GuidanceCommand(Message):
    """Maneuver regulation at s*: p_R^d(s*), f^d(s*), and how much of the horizontal part may act now.

    The filter onboard closes the spring on its own reference with `p_R_d_m`, `f_d_N` and `scale`; `u_A_N` is the paper's
    literal law on the measured robot position, for the record.
    """

    s: float
    path_length_m: float
    p_H_d_m: Vec3
    p_R_d_m: Vec3
    f_d_N: Vec3
    scale: float
    u_A_N: Vec3
    path_error_m: float
    """Signed lateral distance of the hand from the path, left positive."""
