"""Listens to handle, vehicle and supervisor; says at 100 Hz where the robot shall be and what force the hand shall feel."""

from schemas.guidance import GuidanceCommand
from schemas.message import Vec3
from schemas.safety import Permit
from schemas.topics import GUIDANCE, HANDLE_STATE, SAFETY_STATE, VEHICLE_STATE
from services.config import Config
from services.guiding_controller import guiding
from services.guiding_controller.guiding import Guidance, Input
from services.guiding_controller.path import Path
from services.physics import Array, dot
from services.runtime.node import Node, used


async def run(node: Node, config: Config) -> None:
    """One command per tick while handle and vehicle are fresh; an invalid one, with the reason, while they are not."""
    p, path = config.guiding_controller, config.guided_path
    handle, vehicle, safety = node.latest(HANDLE_STATE), node.latest(VEHICLE_STATE), node.latest(SAFETY_STATE)
    out = node.publisher(GUIDANCE)
    state: guiding.State | None = None
    async for tick in node.ticks(GUIDANCE.rate_Hz):
        hand, robot, verdict = handle.value, vehicle.value, safety.value
        if hand is None or robot is None:
            node.status = f"waiting for {HANDLE_STATE.key if hand is None else VEHICLE_STATE.key}"
            out.publish(_nothing(path, node.status, used(handle, vehicle, safety, tick=tick)))
            continue
        p_H, p_R = hand.position_m.array(), robot.position_m.array()
        guides = verdict is not None and verdict.permit is Permit.GUIDE
        if state is None or verdict is None or verdict.permit is Permit.WAIT:
            state = guiding.start(p_H, path)  # whoever takes the handle is met where they stand
        held = verdict is not None and verdict.held
        state, guidance = guiding.step(state, Input(p_H, p_R, held, guides), tick.dt_s, path, p, config.cable)
        node.status = "guiding" if guides and held else "standing by"
        out.publish(_message(guidance, path, p_H, used(handle, vehicle, safety, tick=tick)))


def _message(guidance: Guidance, path: Path, p_H: Array, inputs: dict[str, int]) -> GuidanceCommand:
    lateral = float(dot(p_H - guidance.p_H_d, path.normal(guidance.s)))
    return GuidanceCommand(
        inputs=inputs,
        s=float(guidance.s),
        path_length_m=path.length_m,
        p_H_d_m=Vec3.of(guidance.p_H_d),
        p_R_d_m=Vec3.of(guidance.p_R_d),
        f_d_N=Vec3.of(guidance.f_d),
        scale=float(guidance.scale),
        u_A_N=Vec3.of(guidance.u_A),
        path_error_m=lateral,
    )


def _nothing(path: Path, why: str, inputs: dict[str, int]) -> GuidanceCommand:
    zero = Vec3()
    return GuidanceCommand(
        inputs=inputs,
        valid=False,
        invalid_reason=why,
        s=0.0,
        path_length_m=path.length_m,
        p_H_d_m=zero,
        p_R_d_m=zero,
        f_d_N=zero,
        scale=0.0,
        u_A_N=zero,
        path_error_m=0.0,
    )
