"""The panel fits a terminal of 80 columns and shows a dash, not an old number, for what it does not know."""

import asyncio
import io
from dataclasses import replace

import pytest
from rich.console import Console

from schemas import topics
from schemas.safety import Level, SafetyState
from services.console.panel import View, Watch, line, render
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node
from services.runtime.virtual import VirtualClock, run_virtual
from tests.services import synthetic, synthetic_world

WALK = synthetic_world.Scenario(guiding_s=2.0)


@pytest.fixture(scope="module")
def said():
    """The messages of each topic."""
    found = {}
    for key, payload, _ in synthetic.samples(WALK):
        found.setdefault(key, []).append(topics.BY_KEY[key].type.model_validate_json(payload))
    return found


@pytest.fixture
def walking(said):
    at_ns = synthetic.MONOTONIC_NS + 11_200_000_000
    now = {
        key: next(m for m in messages if m.stamp_ns >= at_ns)
        for key, messages in said.items()
        if "@" not in key and key != "safety/reply"
    }
    return View(
        elapsed_s=11.0,
        safety=now["safety/state"],
        guidance=now["guidance/command"],
        force=now["force/cable"],
        truth=now["sim/truth"],
        setpoint_age_s=0.004,
        services={name: now[topic.key] for name, topic in topics.HEALTH.items()},
    )


def shown(view, width=80):
    screen = io.StringIO()
    Console(width=width, file=screen, force_terminal=False).print(render(view))
    return screen.getvalue()


@pytest.mark.parametrize("width", [80, 120, 200])
def test_every_line_fits_and_every_service_is_named(walking, width):
    lines = shown(walking, width).splitlines()
    assert all(len(text) == width for text in lines)
    text = "\n".join(lines)
    assert all(name in text for name in topics.SERVICES)
    assert "GUIDING" in text
    assert "of 4.17 m" in text
    assert f"{100 * walking.guidance.path_error_m:.1f} cm left" in text
    assert "4 ms" in text


def test_nothing_known_is_shown_as_nothing(said):
    text = shown(View(services=dict.fromkeys(topics.SERVICES)))
    assert "no word from the supervisor" in text
    assert text.count("silent") == len(topics.SERVICES)
    assert "0.0 cm" not in text
    assert "0.0 N" not in text
    assert "–" in line(View())
    assert "no word from the supervisor" in line(View())


@pytest.mark.parametrize("missing", ["safety", "guidance", "force", "truth", "setpoint_age_s"])
def test_any_part_may_be_missing(walking, missing):
    view = replace(walking, **{missing: None})
    assert shown(view)
    assert "\n" not in line(view)


def test_reasons_stand_below_whatever_they_contain(walking):
    safety = walking.safety.model_copy(update={"level": Level.HOLD, "reasons": ["[red]battery[/] at 12 %", "wind"]})
    view = replace(walking, safety=safety)
    assert "[red]battery[/] at 12 %" in shown(view)
    assert "[red]battery[/] at 12 %" in line(view)
    assert "hold" in line(view)


def test_without_truth_the_hand_feels_the_cable_only_while_it_holds(walking):
    free: SafetyState = walking.safety.model_copy(update={"held": False})
    held: SafetyState = walking.safety.model_copy(update={"held": True})
    pull = walking.force.force_N
    assert View(safety=free, force=walking.force).hand_force_N == 0.0
    expected = (pull.x**2 + pull.y**2 + pull.z**2) ** 0.5
    assert View(safety=held, force=walking.force).hand_force_N == pytest.approx(expected)
    assert View(force=walking.force).hand_force_N is None


def test_a_watch_shows_what_is_fresh_and_forgets_what_is_not(walking):
    async def scene():
        bus, clock = MemoryBus(), VirtualClock()
        supervisor = Node("safety_supervisor", bus, clock)
        watch = Watch(Node("operator", bus, clock, observer=True))
        supervisor.publisher(topics.SAFETY_STATE).publish(walking.safety.model_copy(update={"stamp_ns": 0}))
        await asyncio.sleep(0.01)
        first = watch.view()
        await asyncio.sleep(1.0)
        return first, watch.view()

    first, second = run_virtual(scene())
    assert first.safety is not None
    assert first.safety.phase == walking.safety.phase
    assert first.elapsed_s == pytest.approx(0.01)
    assert first.guidance is None
    assert second.safety is None
    assert second.elapsed_s == pytest.approx(1.01)
