"""What a capture system says is put right: frames gathered, repeats thrown out, clocks brought together, axes judged."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.physics import integrate_attitude, rotation_matrix
from services.tracker import axes, bodies, robot, stamps
from services.tracker.axes import Verdict
from services.tracker.bodies import Body, Seen
from services.tracker.filtering import Filter, Sample
from services.tracker.robot import Belief
from services.tracker.rotation import from_matrix
from tests.laws.strategies import vectors

BOTH = frozenset({"robot", "handle"})
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def pose(x: float = 0.0) -> bodies.Pose:
    return (x, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


def gathered(*arrivals: tuple[int, str]) -> list[tuple[int, set[str]]]:
    """Of bodies that arrive at times in ms: what is said, as ms and names."""
    waiting, said = Seen(0, {}), []
    for ms, names in arrivals:
        poses = {name: pose() for name in names.split()}
        waiting, frames = bodies.gather(waiting, Seen(ms * 1_000_000, poses), BOTH)
        said += [(frame.stamp_ns // 1_000_000, set(frame.poses)) for frame in frames]
    return said


def test_bodies_that_come_together_are_a_frame_at_once():
    assert gathered((1, "robot handle chair"), (11, "handle robot")) == [(1, set(BOTH)), (11, set(BOTH))]


def test_bodies_that_come_one_by_one_are_a_frame_as_old_as_its_first():
    assert gathered((1, "robot"), (3, "handle"), (11, "robot"), (13, "handle")) == [(1, set(BOTH)), (11, set(BOTH))]


def test_a_body_does_not_wait_for_one_that_stays_away():
    assert gathered((1, "robot"), (11, "robot"), (21, "robot")) == [(1, {"robot"}), (11, {"robot"})]
    assert gathered((1, "robot"), (9, "chair"), (17, "chair")) == [(1, {"robot"})]


@given(st.lists(st.tuples(st.integers(1, 9), st.sets(st.sampled_from(["robot", "handle", "chair"]))), max_size=40))
def test_nothing_is_said_twice_or_out_of_order(arrivals):
    """Each body carries the time of its arrival: a pose that is said is the newest of its frame, and said once."""
    waiting, said, ms = Seen(0, {}), [], 0
    for step_ms, names in arrivals:
        ms += step_ms
        now = Seen(ms * 1_000_000, {name: pose(float(ms)) for name in names})
        waiting, frames = bodies.gather(waiting, now, BOTH)
        said += frames
    times = [frame.stamp_ns for frame in said]
    assert times == sorted(set(times))
    for name in BOTH:
        xs = [frame.poses[name][0] for frame in said if name in frame.poses]
        assert xs == sorted(set(xs))
    for frame in said:
        assert frame.poses
        assert min(p[0] for p in frame.poses.values()) * 1e6 == frame.stamp_ns


def test_a_pose_counts_until_it_has_not_changed_by_a_bit_for_long():
    last, moving = {}, []
    for ms in range(0, 100, 10):
        seen = Seen(ms * 1_000_000, {"robot": pose(1e-9 * ms), "handle": pose(1e-9 * (ms // 40))})
        last, now = bodies.unrepeated(last, seen, 0.03)
        moving.append("handle" in now.poses)
        assert "robot" in now.poses
    assert moving == [True, True, True, False, True, True, True, False, True, True]


@pytest.mark.parametrize("wrong", [(float("nan"), *pose()[1:]), (0.0,) * 7, (0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0)])
def test_what_a_driver_says_of_an_unseen_body_is_no_pose(wrong):
    assert bodies.usable(pose())
    assert not bodies.usable(wrong)


@given(vectors(3.0), vectors(1.0))
def test_the_offset_turns_with_the_body(turn, offset):
    q = integrate_attitude(LEVEL, turn, 1.0)
    p, attitude = bodies.placed((1.0, 2.0, 3.0, *(1.004 * q)), Body(body="handle", offset_m=tuple(offset)))
    assert p == pytest.approx(np.array([1.0, 2.0, 3.0]) + rotation_matrix(q) @ offset, abs=1e-12)
    assert np.linalg.norm(attitude) == pytest.approx(1.0)


@given(vectors(6.0))
def test_an_attitude_from_its_matrix(turn):
    q = integrate_attitude(LEVEL, turn, 1.0)
    x, y, z = rotation_matrix(q).tolist()
    found = np.array(from_matrix((x, y, z)))
    assert abs(found @ q) == pytest.approx(1.0, abs=1e-9)


def test_no_attitude_from_nothing():
    row = (float("nan"),) * 3
    assert not bodies.usable((0.0, 0.0, 0.0, *from_matrix((row, row, row))))


def stamped(delays_ns):
    """Frames each 10 ms of the source's clock, in order, with a network's delays: arrivals and stamps."""
    state, arrival_ns = stamps.State(), 0
    for n, delay_ns in enumerate(delays_ns):
        arrival_ns = max(arrival_ns, 7_000_000_000 + n * 10_000_000 + delay_ns)
        state = stamps.step(state, n * 10_000_000, arrival_ns)
        yield arrival_ns, state.stamp_ns


@given(st.lists(st.integers(0, 30_000_000), min_size=2, max_size=60))
def test_a_stamp_is_never_later_than_its_arrival_nor_before_the_last(delays_ns):
    said = list(stamped(delays_ns))
    assert all(stamp_ns <= arrival_ns for arrival_ns, stamp_ns in said)
    assert [stamp_ns for _, stamp_ns in said] == sorted(stamp_ns for _, stamp_ns in said)


@given(st.lists(st.integers(100_000, 30_000_000), max_size=60))
def test_after_a_fast_frame_the_steps_are_the_sources(delays_ns):
    """Whatever the network adds; the clocks may drift 1e-4 of 10 ms, 1 us, from frame to frame."""
    times = [stamp_ns for _, stamp_ns in stamped([0, *delays_ns])]
    assert all(abs(b - a - 10_000_000) <= 1_000 for a, b in itertools.pairwise(times))


def test_a_source_that_begins_to_count_anew_is_followed():
    state = stamps.State()
    for n in range(100):
        state = stamps.step(state, n * 10_000_000, 5_000_000_000 + n * 10_000_000)
    state = stamps.step(state, 0, 6_500_000_000)
    assert state.stamp_ns == 6_500_000_000
    state = stamps.step(state, 50_000_000_000, 6_510_000_000)  # and one that counts ahead
    assert state.stamp_ns == 6_510_000_000


P_AXES = axes.Axes(floor_m=0.3, still_m=0.005, still_s=0.5, tilt_max_rad=0.2)


def judged(R, H, q=LEVEL, seconds: float = 1.0, noise_m: float = 1e-4) -> axes.State:
    rng, state = np.random.default_rng(1), axes.start()
    for _ in range(round(60 * seconds)):
        state = axes.step(state, np.array([R, H]) + rng.normal(0.0, noise_m, (2, 3)), q, 1 / 60, P_AXES)
    return state


ON_FLOOR = ([-2.0, -0.5, 0.08], [-2.0, -0.9, 0.02])


def y_up(p):
    """A point as a system says it whose y is up and whose z points to the right of its x."""
    x, y, z = p
    return [x, z, -y]


def test_bodies_on_the_floor_show_which_way_is_up():
    assert judged(*ON_FLOOR).verdict is Verdict.RIGHT
    R, H = map(y_up, ON_FLOOR)
    state = judged(R, H)
    assert state.verdict is Verdict.Y_UP
    assert axes.complaint(state).startswith("the capture system's y axis is up: robot and handle lie still at y = 0.0")
    assert "let it stream with z up" in axes.complaint(state)


def test_a_body_that_was_not_defined_level_is_told():
    state = judged(*ON_FLOOR, q=integrate_attitude(LEVEL, np.array([0.0, 0.5, 0.0]), 1.0))
    assert state.verdict is Verdict.TILTED
    assert "define it anew" in axes.complaint(state)


@pytest.mark.parametrize(
    ("R", "H", "seconds", "noise_m"),
    [
        ([0.0, 1.0, 1.2], [0.0, 1.0, 0.4], 1.0, 1e-4),  # both in somebody's hands
        (*ON_FLOOR, 0.4, 1e-4),  # not for long enough
        (*map(y_up, ON_FLOOR), 1.0, 0.02),  # moving
    ],
)
def test_nothing_is_said_without_a_reason(R, H, seconds, noise_m):
    state = judged(R, H, seconds=seconds, noise_m=noise_m)
    assert state.verdict is Verdict.UNKNOWN
    assert axes.complaint(state) == ""


def test_what_was_right_stays_right():
    state = judged(*ON_FLOOR)
    assert axes.step(state, np.array([*map(y_up, ON_FLOOR)]), LEVEL, 10.0, P_AXES) is state


P_ROBOT = robot.Robot(
    motion=Filter(tau_s=0.03, gate_m=0.05, gate_mps=3.0, lost_s=0.3, settle_s=0.1),
    turn_rad=0.35,
    turn_rad_s=4.0,
    belief_m=0.25,
    belief_mps=0.1,
    belief_rad=0.5,
)
NOWHERE = Belief(np.zeros(3), LEVEL, flying=False)
FLYING = Belief(np.zeros(3), LEVEL, flying=True)


def after(seconds, z, belief, state=None, q=LEVEL, measured=True):
    """The state, and what became of each pose of `seconds` at z."""
    state, samples = state or robot.start(), []
    for _ in range(round(60 * seconds)):
        state, output = robot.step(state, np.asarray(z), q, measured, belief, 1 / 60, P_ROBOT)
        samples.append(Sample(int(output.sample)))
    return state, samples


@given(vectors(1.0).filter(lambda v: np.linalg.norm(v) > 0.26), st.floats(1.0, 8.0))
def test_in_flight_a_world_that_has_moved_is_refused_for_ever(shift, seconds):
    state, _ = after(1.0, np.zeros(3), FLYING)
    _, samples = after(seconds, shift, FLYING, state)
    assert set(samples) == {Sample.JUMP}


def test_on_the_ground_it_begins_anew_where_it_is_seen():
    state, _ = after(1.0, np.zeros(3), NOWHERE)
    _, samples = after(1.0, [0.5, 0.0, 0.0], NOWHERE, state)
    assert samples.index(Sample.RESTART) / 60 == pytest.approx(0.3, abs=0.04)
    assert samples[-1] is Sample.ACCEPTED


def test_a_robot_that_was_hidden_is_found_again_where_the_autopilot_believes_it_to_be():
    state, _ = after(1.0, np.zeros(3), FLYING)
    state, _ = after(2.0, np.zeros(3), FLYING, state, measured=False)
    for x, sample in ((0.44, Sample.RESTART), (0.46, Sample.JUMP)):  # 0.25 m, and what it may have drifted in 2 s
        assert after(0.05, [x, 0.0, 0.0], FLYING, state)[1][0] is sample


def test_swapped_markers_turn_the_robot_at_once_and_are_refused():
    turned = integrate_attitude(LEVEL, np.array([0.0, 0.0, np.pi / 2]), 1.0)
    state, _ = after(1.0, np.zeros(3), FLYING)
    state, samples = after(3.0, np.zeros(3), FLYING, state, q=turned)
    assert set(samples) == {Sample.JUMP}
    _, samples = after(0.1, np.zeros(3), FLYING, state)
    assert samples[-1] is Sample.ACCEPTED


def test_a_tracker_that_is_started_in_flight_believes_the_autopilot():
    assert after(0.1, [0.5, 0.0, 0.0], FLYING)[1][0] is Sample.JUMP
    assert after(0.1, [0.1, 0.0, 0.0], FLYING)[1][0] is Sample.RESTART
