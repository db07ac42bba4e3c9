"""How often the simulator speaks by itself, and every service in a flight."""

import asyncio

import pytest

from schemas.safety import Action, Permit, Phase
from schemas.topics import GATEWAYS, MOCAP_FRAME, SAFETY_STATE, TOPICS, TRUTH
from services.config import load
from services.rehearsal.chain import Stage
from services.rehearsal.direct_vehicle import DirectVehicle
from services.simulator import service as simulator
from tests.services.alone import Alone, alone, lasting, rate_Hz, verdict
from tests.services.chain import fly

CONFIG = load("demo")


def test_the_simulator_shows_frames_and_truth_at_their_rates():
    async def play(stage: Alone) -> None:
        node = stage.node("simulator")
        await simulator.play(node, CONFIG, DirectVehicle(CONFIG.px4_bridge.vehicle, stage.clock.now_ns))

    said = alone(play, {SAFETY_STATE: lambda _: verdict(Phase.IDLE, Permit.NONE)}, lasting(1.5))
    frames, truths = said[MOCAP_FRAME.key], said[TRUTH.key]
    assert rate_Hz(frames) == pytest.approx(CONFIG.simulator.mocap_rate_Hz, rel=0.02)
    assert CONFIG.simulator.mocap_rate_Hz == MOCAP_FRAME.rate_Hz
    assert rate_Hz(truths) == pytest.approx(TRUTH.rate_Hz, rel=0.02)
    start = CONFIG.guided_path.p(0.0)
    assert truths[-1].robot_position_m.array()[:2] == pytest.approx(start[:2], abs=1e-3)
    assert not truths[-1].holding
    seen = frames[-1].robot.position_m.array()
    assert seen == pytest.approx(truths[-1].robot_position_m.array(), abs=0.003)


def test_every_topic_is_said_by_its_publisher_at_the_rate_of_the_table():
    """The recorder does not fly; what is on demand has no rate."""

    async def script(stage: Stage) -> None:
        await asyncio.sleep(0.5)
        stage.ask(Action.START)
        await asyncio.sleep(1.7)

    said = fly(CONFIG, script).said
    for topic in TOPICS:
        if topic.rate_Hz and topic.publisher not in ("recorder", *GATEWAYS.values()):
            flying = [m for m in said[topic.key] if m.stamp_ns > 1.6e9]
            assert len(flying) >= 2, f"{topic.key} is not said"
            assert rate_Hz(flying) == pytest.approx(topic.rate_Hz, rel=0.1), topic.key
