"""What the bridge believes: a last look at numbers from other processes, for a thousandfold or a sign that slipped through.

Not whether they are right, which the supervisor judges; only whether they can be. What cannot be counts as not said, and grows
stale like silence.
"""

from services.parameters import Positive, parameters
from services.physics import Array, components, norm
from services.px4_bridge.flight import Guidance


@parameters
class Trust:
    """The largest that can be true."""

    force_max_N: Positive
    """Of the cable, far above what any person pulls."""
    push_max_N: Positive
    """Downwards on the vehicle's side: a cable cannot push, an estimate errs by less than this."""
    f_d_max_N: Positive
    """Of the guiding force, f_z included."""
    pose_apart_m: Positive
    """Between motion capture and the autopilot's own estimate in flight."""
    lead_max_m: Positive
    """From the reference to where guidance wants the robot."""


def credible_force(f_c: Array, p: Trust) -> bool:
    """Whether a cable can do that to a hand below the vehicle."""
    return bool(norm(f_c) <= p.force_max_N) and components(f_c)[2] >= -p.push_max_N


def credible_guidance(guidance: Guidance, p_ref: Array, p: Trust) -> bool:
    """Whether guidance can mean that; `p_ref` is where the reference is now, (3,) m."""
    near = bool(norm(guidance.p_R_d - p_ref) <= p.lead_max_m) and 0.0 <= guidance.scale <= 1.0
    return near and bool(norm(guidance.f_d) <= p.f_d_max_N) and components(guidance.f_d)[2] >= 0.0
