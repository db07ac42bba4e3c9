"""`clew explain`: known energies of a made-up session, one clear line for what is no session, and a filter found out.

That a flown recording is explained is tested with the flight itself, in test_flight.py.
"""

import numpy as np
import pytest
from typer.testing import CliRunner

from schemas.safety import Phase
from schemas.topics import ENERGY, SAFETY_STATE, TRUTH
from services.console.cli import app
from services.recorder.passivity import filter_books, physical_books, walk, worst
from services.recorder.reading import read
from tests.services import synthetic
from tests.services.synthetic import GUIDED_W
from tests.services.synthetic_world import Scenario, World


def told(*arguments: object):
    return CliRunner().invoke(app, ["explain", *map(str, arguments)])


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return synthetic.write(tmp_path_factory.mktemp("sessions") / "session.mcap")


def test_the_filters_books_are_those_that_were_written(file):
    books = filter_books(read(file))
    assert books.balance.guidance_J[-1] == pytest.approx(GUIDED_W * Scenario().guiding_s)
    assert books.balance.cable_J[-1] == pytest.approx(-0.5 * GUIDED_W * Scenario().guiding_s)
    assert np.max(np.abs(books.balance.residual_J)) < 1e-12


def test_the_physical_books_follow_from_the_true_motion(file):
    """The made-up robot obeys no law, but work is work: of -f_c along its way, against the midpoints' sum."""
    session = read(file)
    books, truth = physical_books(session), session.table(TRUTH)
    flies = np.gradient(books.balance.dissipated_J) > 0.0
    power = -np.sum(truth["cable_force_N"] * truth["robot_velocity_mps"], axis=-1)
    expected = float(np.sum(power[flies]) / TRUTH.rate_Hz)
    assert books.balance.cable_J[-1] == pytest.approx(expected, rel=0.02)
    assert expected < -1.0


def test_v_of_the_walk_ends_near_zero_and_its_observed_rate_adds_up_to_it(file):
    walked = walk(read(file))
    assert walked is not None
    assert walked.V_J[0] > 30.0
    observed = np.trapezoid(walked.observed_W, walked.t_s)
    assert observed == pytest.approx(walked.V_J[-1] - walked.V_J[0], rel=0.01)


@pytest.mark.parametrize("given", ["session.mcap", "."], ids=["file", "folder"])
def test_it_prints_tables_and_writes_the_figure(file, given, tmp_path):
    result = told(file.parent / given, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert f"{GUIDED_W * Scenario().guiding_s:.3f} J" in result.output
    assert "passive at its port throughout" in result.output
    assert (tmp_path / "energy.png").stat().st_size > 10_000


def test_a_filter_that_made_energy_is_found_out(tmp_path):
    result = told(synthetic.write(tmp_path / "session.mcap", Scenario(made_J=0.01)))
    assert result.exit_code == 1
    assert "made 0.01 J out of nothing" in result.output
    assert "at 12.0 s (guiding)" in result.output


def test_what_a_recording_does_not_tell_is_unknown(tmp_path):
    """On hardware there is no truth, in old recordings no balance: neither is an error."""
    result = told(synthetic.write(tmp_path / "session.mcap", Scenario(truth=False)))
    assert result.exit_code == 0, result.output
    assert "needs the simulator's truth" in result.output
    silent = Scenario(dropped={ENERGY.key: set(range(1, 10_000))})
    result = told(synthetic.write(tmp_path / "old.mcap", silent))
    assert result.exit_code == 0, result.output
    assert "no energy/balance in this recording" in result.output


def test_a_session_in_which_nobody_was_guided_says_so_and_tells_the_rest(tmp_path):
    led = int(World(Scenario()).start[Phase.GUIDING] * SAFETY_STATE.rate_Hz)
    file = synthetic.write(tmp_path / "session.mcap", Scenario(dropped={SAFETY_STATE.key: set(range(led - 5, 9999))}))
    result = told(file)
    assert result.exit_code == 0, result.output
    assert "nobody was guided" in result.output
    result = CliRunner().invoke(app, ["report", str(file)])
    assert result.exit_code == 0, result.output
    assert result.stdout.split() == [str(tmp_path / "report.html")]
    assert "nobody was guided: it has no phase 2" in result.stderr
    assert "nobody was guided: it has no phase 2" in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize("content", [b"", b"garbage", b"\x89MCAP0\r\n\x00" * 3, None])
def test_no_recording_is_one_clear_line_and_2(content, tmp_path):
    file = tmp_path / "session.mcap"
    if content is not None:
        file.write_bytes(content)
    result = told(file)
    lines = result.output.strip().splitlines()
    assert len(lines) == 1, result.output
    assert str(file) in lines[0]
    assert result.exit_code == 2


def test_the_worst_is_the_deepest_fall_from_any_earlier_value():
    t_s, curve = np.arange(6.0), np.array([0.0, 2.0, 1.0, 3.0, 0.5, 4.0])
    assert worst(t_s, curve) == (2.5, 4.0)
    assert worst(t_s, np.arange(6.0)) == (0.0, 0.0)
