"""The whole experiment on virtual time, and what happens when something breaks in the middle of it."""

import asyncio
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from schemas.safety import Action, Level, Permit, Phase
from schemas.topics import CABLE_FORCE, ENERGY, HANDLE_STATE, MOCAP_FRAME, SETPOINT, TRUTH, Stance
from schemas.tracking import HandleSource, MocapFrame, RigidBody
from services.config import load
from services.console.cli import app
from services.guiding_controller import maneuver
from services.recorder import metrics
from services.recorder.passivity import filter_books, physical_books, walk, worst
from services.recorder.reading import read
from services.rehearsal.chain import Flight, Stage, until_guiding
from services.rehearsal.quick import quick_config
from services.simulator.human import Event, Kind
from tests.services.chain import fly
from tests.services.record import record


@pytest.fixture(scope="module")
def flight(flown) -> Flight:
    return flown[0]


def vectors(messages, name):
    return np.array([getattr(m, name).array() for m in messages])


def stamps(messages):
    return np.array([m.stamp_ns for m in messages]) * 1e-9


def at(times, messages, name):
    """A vector of other messages, interpolated to `times`."""
    v, t = vectors(messages, name), stamps(messages)
    return np.stack([np.interp(times, t, v[:, i]) for i in range(3)], axis=1)


def test_every_phase_in_order(flight):
    assert flight.phases() == [
        Phase.IDLE,
        Phase.TAKEOFF,
        Phase.ZEROING,
        Phase.READY,
        Phase.GUIDING,
        Phase.ARRIVED,
        Phase.CLEARING,
        Phase.LANDING,
        Phase.LANDED,
    ]


def test_the_hand_follows_the_path(flight):
    hand = vectors(flight.during(TRUTH.key, Phase.GUIDING), "hand_position_m")
    error = metrics.path_error(hand, flight.config.guided_path, np.linspace(0.0, 1.0, 201))
    assert np.nanmean(np.abs(error)) < 0.035
    assert np.nanmax(np.abs(error)) < 0.065
    end = flight.config.guided_path.p(1.0)
    assert np.hypot(*(hand[-1] - end)[:2]) < 0.10


def test_the_pull_is_gentle_and_the_cable_taut(flight):
    everything = flight.said[TRUTH.key]
    assert np.max(np.linalg.norm(vectors(everything, "hand_force_N"), axis=1)) < 2.5
    walk = flight.during(TRUTH.key, Phase.GUIDING)
    length = np.linalg.norm(vectors(walk, "robot_position_m") - vectors(walk, "hand_position_m"), axis=1)
    assert metrics.slack_fraction(length[:, None] * [1.0, 0.0, 0.0], flight.config.cable.rest_length_m) < 0.02


def test_the_estimate_is_near_the_truth(flight):
    estimates = flight.during(CABLE_FORCE.key, Phase.GUIDING)
    error = vectors(estimates, "force_N") - at(stamps(estimates), flight.said[TRUTH.key], "cable_force_N")
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 0.08


def test_the_robot_follows_the_filter(flight):
    sent = flight.during(SETPOINT.key, Phase.GUIDING)
    error = vectors(sent, "position_m") - at(stamps(sent), flight.said[TRUTH.key], "robot_position_m")
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 0.04


def test_the_walk_costs_no_more_than_its_path_and_never_feels_the_tank(flight):
    """That the books close is checked in every flight, see chain.py."""
    books, tank = flight.during(ENERGY.key, Phase.GUIDING), flight.config.px4_bridge.tank
    assert all(m.tank_scale == 1.0 for m in flight.said[ENERGY.key])
    assert books[0].tank_J == tank.capacity_J
    assert tank.fade_J < books[-1].tank_J < tank.capacity_J - 0.8 * maneuver.work(flight.config.guided_path)
    worked = books[0].cable_J - books[-1].cable_J
    assert worked == pytest.approx(maneuver.work(flight.config.guided_path), rel=0.25), "the person was not led by this"


def test_the_session_explains_itself(flight, tmp_path):
    """V falls from the start's to nothing, as fast as Thm 2 to 4 say; what the true vehicle adds is little and told."""
    session = read(record(tmp_path / "session.mcap", flight))
    walked, filtered, physical = walk(session), filter_books(session), physical_books(session)
    assert walked is not None
    assert walked.V_J[0] > 30.0
    assert np.min(walked.V_J) >= 0.0
    assert walked.V_J[-1] < 0.02
    apart = walked.observed_W - walked.predicted_W
    assert metrics.rms(apart) < 0.02 * metrics.rms(walked.predicted_W)
    assert worst(filtered.t_s, filtered.balance.residual_J).fall < 1e-9
    assert worst(physical.t_s, physical.balance.residual_J).fall < 0.3
    for name in ("guidance_J", "cable_J", "dissipated_J"):
        true, seen = getattr(physical.balance, name)[-1], getattr(filtered.balance, name)[-1]
        assert true == pytest.approx(seen, rel=0.1)
    result = CliRunner().invoke(app, ["explain", str(tmp_path / "session.mcap")])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "energy.png").stat().st_size > 10_000


def test_the_propellers_stay_clear_of_the_head(flight):
    held = [m for m in flight.said[TRUTH.key] if m.holding]
    distance = np.linalg.norm(vectors(held, "robot_position_m") - vectors(held, "head_position_m"), axis=1)
    assert np.min(distance) - flight.config.safety_supervisor.envelope.rotor_tip_m > 0.4


def test_the_same_seed_says_the_same_bytes():
    async def takeoff(stage: Stage) -> None:
        await asyncio.sleep(0.5)
        stage.ask(Action.START)
        await asyncio.sleep(3.0)

    one, other = fly(load("demo"), takeoff), fly(load("demo"), takeoff)
    assert {k: [m.model_dump_json() for m in v] for k, v in one.said.items()} == {
        k: [m.model_dump_json() for m in v] for k, v in other.said.items()
    }


def worst_pull_after(flight: Flight, t_s: float) -> float:
    after = [m for m in flight.said[TRUTH.key] if m.stamp_ns * 1e-9 > t_s]
    return float(np.max(np.linalg.norm(vectors(after, "hand_force_N"), axis=1)))


def test_a_person_who_lets_go_is_not_left_behind_by_a_runaway():
    config = quick_config()
    lets_go = replace(config.person, behaviour=(Event(kind=Kind.LET_GO, start_s=6.0),))
    config = config.model_copy(update={"person": lets_go})

    async def script(stage: Stage) -> None:
        await until_guiding(stage)
        await stage.until(lambda state: not state.held, 30.0)
        await asyncio.sleep(4.0)

    flight = fly(config, script)
    walked_ns = flight.during(TRUTH.key, Phase.GUIDING)[0].stamp_ns
    free = [m for m in flight.said[TRUTH.key] if not m.holding and m.stamp_ns > walked_ns]
    moved = vectors(free, "robot_position_m") - vectors(free[:1], "robot_position_m")
    assert np.max(np.linalg.norm(moved, axis=1)) < 0.6
    assert np.max(vectors(free, "robot_position_m")[:, 2]) < config.px4_bridge.flight.ceiling_m + 0.1


def test_stop_eases_and_resume_goes_on():
    async def script(stage: Stage) -> None:
        await until_guiding(stage, for_s=4.0)
        stage.ask(Action.EASE, 2)
        eased = await stage.until(lambda state: state.permit is Permit.EASE, 1.0)
        assert eased.level is Level.EASE
        await asyncio.sleep(1.5)
        calm = stage.flight.said[TRUTH.key][-20:]
        assert np.max(np.linalg.norm(vectors(calm, "hand_force_N"), axis=1)) < 0.3
        stage.ask(Action.RESUME, 3)
        await stage.until(lambda state: state.permit is Permit.GUIDE, 3.0)
        await asyncio.sleep(3.0)
        pulled = stage.flight.said[TRUTH.key][-20:]
        assert np.min(np.linalg.norm(vectors(pulled, "hand_force_N"), axis=1)) > 0.8

    fly(quick_config(), script)


def test_a_hidden_handle_is_replaced_by_the_cable_and_nobody_is_pulled_blindly():
    hidden = []

    async def script(stage: Stage) -> None:
        put, blind = stage.bus.put, asyncio.Event()

        def hide(key: str, payload: bytes, stance: Stance) -> None:
            if key == MOCAP_FRAME.key and blind.is_set():
                frame = MocapFrame.model_validate_json(payload)
                unseen = frame.handle.model_copy(update={"tracked": False})
                payload = frame.model_copy(update={"handle": unseen}).model_dump_json().encode()
            put(key, payload, stance)

        stage.bus.put = hide
        await until_guiding(stage, for_s=4.0)
        blind.set()
        hidden.append(stage.operator.clock.now_ns())
        await asyncio.sleep(2.0)
        hidden.append(stage.operator.clock.now_ns())
        blind.clear()
        await stage.until(lambda state: state.permit is Permit.GUIDE, 5.0)

    flight = fly(quick_config(), script)
    begin, end = hidden
    guessed = [m for m in flight.said[HANDLE_STATE.key] if begin < m.stamp_ns < end and m.source is HandleSource.CABLE]
    assert guessed
    error = vectors(guessed, "position_m") - at(stamps(guessed), flight.said[TRUTH.key], "handle_position_m")
    assert np.max(np.linalg.norm(error, axis=1)) < 0.15
    assert worst_pull_after(flight, begin * 1e-9) < 2.5


def test_a_vehicle_that_is_not_seen_pulls_no_more_and_then_comes_down():
    """The autopilot's own position goes on after the last pose, and does not say that it counts for 4.7 s only."""
    hidden = []

    async def script(stage: Stage) -> None:
        put = stage.bus.put

        def hide(key: str, payload: bytes, stance: Stance) -> None:
            if key == MOCAP_FRAME.key and hidden:
                frame = MocapFrame.model_validate_json(payload)
                payload = frame.model_copy(update={"robot": RigidBody(tracked=False)}).model_dump_json().encode()
            put(key, payload, stance)

        stage.bus.put = hide
        await until_guiding(stage, for_s=3.0)
        hidden.append(stage.operator.clock.now_ns())
        await stage.until(lambda state: state.permit is Permit.EASE, 1.6)
        await stage.until(lambda state: state.level is Level.DESCEND, 1.1)
        await asyncio.sleep(1.0)

    flight = fly(quick_config(), script)
    (t_ns,) = hidden
    assert worst_pull_after(flight, t_ns * 1e-9) < 2.5
    assert worst_pull_after(flight, t_ns * 1e-9 + 2.5) < 1.0
