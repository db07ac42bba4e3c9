"""The world in real time: vehicle, cable, handle, person, and the autopilot that flies them: the stand-in, or PX4 in software.

It says what the capture system sees and, for reports, the truth. It listens to the supervisor only as the simulated person
listens to the experimenter: to be told when to take the handle and when to let go.
"""

from schemas.safety import Phase, SafetyState
from schemas.topics import MOCAP_FRAME, SAFETY_STATE, TRUTH
from services.config import Config
from services.runtime.node import Node
from services.runtime.pace import Pace
from services.runtime.readers import Latest
from services.simulator import px4_process
from services.simulator.autopilot import STEP_S, Link
from services.simulator.mavlink import MavlinkLink
from services.simulator.pilot import StandIn
from services.simulator.stage import Stage
from services.simulator.world import Told

SILENCE_SEEN_S = 1.5
CATCH_UP_S = 0.1
"""After a stall of the host the world goes on by at most this much: what it did in between was not calculated."""


async def run(node: Node, config: Config) -> None:
    """Fly by PX4 where the profile has it, else play the vehicle on the profile's MAVLink address."""
    simulator = config.simulator
    if simulator.px4_sitl is not None:
        node.status = "waiting for PX4"
        laboratory = config.px4_bridge.px4
        async with px4_process.connected(simulator.px4_sitl, config.vehicle, laboratory, config.session_dir) as px4:
            await act(node, Stage(config, lambda _: px4))
    else:
        host, port = simulator.companion.rsplit(":", 1)
        with MavlinkLink((host, int(port))) as link:
            await play(node, config, link)


async def play(node: Node, config: Config, link: Link) -> None:
    """The world with the stand-in behind `link`."""
    await act(node, standing_in(config, link))


def standing_in(config: Config, link: Link) -> Stage:
    """The world with the stand-in."""
    return Stage(config, lambda robot: StandIn(config.simulator.autopilot, robot, link))


async def act(node: Node, stage: Stage) -> None:
    """The world's loop at the autopilot's 250 Hz."""
    frames, truths = node.publisher(MOCAP_FRAME), node.publisher(TRUTH)
    safety = node.latest(SAFETY_STATE)
    frame_pace, truth_pace = Pace(stage.config.simulator.mocap_rate_Hz), Pace(TRUTH.rate_Hz)
    async for tick in node.ticks(1.0 / STEP_S):
        steps = round(min(tick.dt_s, CATCH_UP_S) / STEP_S)
        if (lost_s := tick.dt_s - steps * STEP_S) > 0.5 * STEP_S:
            stage.stand_still(lost_s)
        for left in reversed(range(steps)):  # a late turn makes up for what it missed, each sample at its own time
            stage.step(_told(safety))
            now_ns = tick.stamp_ns - left * round(1e9 * STEP_S)
            if frame_pace.due(now_ns):
                frames.publish(stage.capture().model_copy(update={"stamp_ns": now_ns}))
            if truth_pace.due(now_ns):
                truths.publish(stage.truth().model_copy(update={"stamp_ns": now_ns}))
        node.status = f"subject {stage.world.subject.phase.value}"


def _told(safety: Latest[SafetyState]) -> Told:
    """What the experimenter says, who watches the supervisor's phase, and knows what to say when it falls silent."""
    phase = safety.message.phase if safety.message else Phase.IDLE
    if safety.message and safety.age_s > SILENCE_SEEN_S:
        return Told(let_go=True)
    return Told(
        take=phase in (Phase.READY, Phase.GUIDING),
        let_go=phase in (Phase.CLEARING, Phase.LANDING, Phase.LANDED, Phase.KILLED),
    )
