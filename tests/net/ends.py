"""Both ends of a conversation over the radio, as processes: `python -m tests.net.ends voice|ear PROFILE NAME ...`.

voice PROFILE NAME KEY RATE_Hz SECONDS [BYTES]   says a topic's message at a rate, as the service NAME, and prints what
                                                it sent; BYTES pads each, for bulk
ear   PROFILE NAME SECONDS KEY...               hears topics as NAME and prints, for each message, its arrival and age,
                                                then what was refused; `+` before a key prints the message too. 0 seconds: until
                                its standard input ends
first PROFILE NAME SECONDS KEY                  waits for one valid message and prints it
who   PROFILE NAME                              prints which names hold a token
fly   PROFILE NAME SECONDS PHASE                starts the experiment as NAME, prints what the supervisor says whenever it
                                                says something else, and at last `reached` and the phase
until PROFILE NAME SECONDS PHASE                the same of an experiment that goes on
"""

import asyncio
import json
import random
import re
import sys
from collections import Counter
from typing import Any

from schemas.estimation import CableForce, Tare
from schemas.guidance import GuidanceCommand
from schemas.message import Message, Quaternion, Vec3
from schemas.safety import Action
from schemas.simulation import Truth
from schemas.topics import BY_KEY, SAFETY_STATE, Topic
from schemas.tracking import HandleSource, HandleState
from services.config import load
from services.console.operator import Operator
from services.console.start import bus_config
from services.runtime.clock import MonotonicClock
from services.runtime.node import Node
from services.runtime.zenoh_bus import open_bus

ZERO = Vec3()
THIRD = Vec3(x=1 / 3, y=-2 / 3, z=10 / 3)  # as many digits as a measurement has


def message(key: str, padding: int) -> Message:
    """Something to say on a topic."""
    made: dict[str, Message] = {
        "guidance/command": GuidanceCommand(
            inputs={"handle/state": 12345, "vehicle/state": 23456, "safety/state": 34567},
            s=1 / 3,
            path_length_m=4.17,
            p_H_d_m=THIRD,
            p_R_d_m=THIRD,
            f_d_N=THIRD,
            scale=1.0,
            u_A_N=THIRD,
            path_error_m=1 / 7,
        ),
        "handle/state": HandleState(position_m=THIRD, velocity_mps=THIRD, source=HandleSource.MOCAP, lag_s=0.06),
        "force/cable": CableForce(
            force_N=THIRD,
            observed_N=THIRD,
            bias_N=THIRD,
            bias_change_N=1 / 7,
            taut=True,
            slack_m=0.0,
            tare=Tare.PASSED,
            tare_report="",
        ),
        "sim/truth": Truth(
            robot_position_m=THIRD,
            robot_velocity_mps=THIRD,
            robot_q_WB_wxyz=Quaternion(),
            hand_position_m=THIRD,
            hand_velocity_mps=THIRD,
            handle_position_m=THIRD,
            handle_velocity_mps=THIRD,
            head_position_m=THIRD,
            cable_force_N=THIRD,
            hand_force_N=THIRD,
            holding=True,
            subject=random.randbytes(padding // 2).hex(),
        ),
    }
    return made[key]


async def voice(node: Node, topic: Topic[Any], rate_Hz: float, seconds: float, padding: int) -> None:
    """Say it, and say that it was said."""
    out, what = node.publisher(topic), message(topic.key, padding)
    print("speaking", flush=True)
    async for tick in node.ticks(rate_Hz):
        sent = out.publish(what)
        if tick.n >= seconds * rate_Hz:
            print(json.dumps({"last": sent.seq}), flush=True)
            return


async def compared(node: Node, topics: list[Topic[Any]]) -> None:
    """Until the age of what they carry is known: half a second where both gateways run; where not, 3 s and no longer.

    A command that comes before is refused, and rightly.
    """
    for _ in range(60):
        if all(node.hosts.here_ns(topic.publisher, 0) is not None for topic in topics):
            return
        await asyncio.sleep(0.05)


class Listener(Node):
    """Also counts why, whatever the numbers."""

    def __init__(self, *how: Any, **more: Any) -> None:
        super().__init__(*how, **more)
        self.why: Counter[str] = Counter()

    def reject(self, topic_key: str, why: str) -> None:
        self.why[re.sub(r"[0-9.]+", "N", why)] += 1
        super().reject(topic_key, why)


async def ear(node: Listener, topics: list[Topic[Any]], seconds: float, whole: set[str]) -> None:
    """Hear, and print at the end, so that printing delays nothing."""
    heard: list[tuple[dict[str, Any], Message | None]] = []

    async def hear(topic: Topic[Any]) -> None:
        stream = node.stream(topic, depth=1024)
        async for said in stream:
            now_ns = node.clock.now_ns()
            entry = {"key": topic.key, "seq": said.seq, "t_s": now_ns * 1e-9, "age_s": stream.age_s}
            heard.append((entry, said if topic.key in whole else None))

    tasks = [asyncio.create_task(hear(topic)) for topic in topics]
    await compared(node, topics)
    print("listening", flush=True)
    await (asyncio.sleep(seconds) if seconds else asyncio.to_thread(sys.stdin.read))
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    for entry, said in heard:
        print(json.dumps(entry | ({"said": said.model_dump(mode="json")} if said else {})))
    print(json.dumps({"rejected": dict(node.rejected), "why": dict(node.why), "clock": node.hosts.two}), flush=True)


async def start(node: Node) -> None:
    """Ask until it does."""
    pilot = Operator(node)
    async for _ in node.ticks(1.0):
        reply = await pilot.ask(Action.START)
        if reply and reply.accepted:
            return


async def until(node: Node, seconds: float, phase: str, *, starts: bool) -> None:
    """Wait for a phase."""
    states, told = node.stream(SAFETY_STATE), ""
    async with asyncio.timeout(seconds):
        if starts:
            await start(node)
        async for state in states:
            if state.phase == phase:
                print("reached", phase, flush=True)
                return
            now = f"{state.phase}, {state.level.name}: {'; '.join(state.reasons)}"
            if now != told:
                print(f"{node.clock.now_ns() * 1e-9:.1f} s: {now}", flush=True)
            told = now


async def main() -> None:
    """As the module says."""
    kind, profile, name, *rest = sys.argv[1:]
    config = bus_config(load(profile))
    with open_bus(config, name) as bus:
        node = Listener(name, bus, MonotonicClock(), observer=True, placement=config.placement)
        if kind == "voice":
            key, rate_Hz, seconds, *padding = rest
            await voice(node, BY_KEY[key], float(rate_Hz), float(seconds), int(*padding or ["0"]))
        elif kind == "first":
            async with asyncio.timeout(float(rest[0])):
                async for said in node.stream(BY_KEY[rest[1]]):
                    if said.valid:
                        print(json.dumps({"key": rest[1], "said": said.model_dump(mode="json")}), flush=True)
                        return
        elif kind in ("fly", "until"):
            await until(node, float(rest[0]), rest[1], starts=kind == "fly")
        elif kind == "who":
            print(json.dumps({"alive": sorted(bus.alive(1.5))}), flush=True)
        else:
            seconds, *keys = rest
            whole = {key[1:] for key in keys if key.startswith("+")}
            await ear(node, [BY_KEY[key.removeprefix("+")] for key in keys], float(seconds), whole)


if __name__ == "__main__":
    asyncio.run(main())
