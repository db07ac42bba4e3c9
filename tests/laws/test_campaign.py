"""The campaign: a crowd walks as each would alone, populations are what their files say, statistics what walks are."""

import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.campaign import batch, population, statistics, vary
from services.campaign.batch import Plan, Prepared
from services.campaign.population import QUANTITIES, UNIFORMS
from services.campaign.walk import Controller
from services.config import load
from services.guiding_controller.path import project
from services.physics import norm
from tests.laws import ideal

pytestmark = pytest.mark.slow

POPULATIONS = Path(__file__).parents[2] / "deploy" / "populations"
GENERAL = tomllib.loads((POPULATIONS / "general.toml").read_text())


def plan(**changed) -> Plan:
    usual = Plan(4, 2, 1, Controller.REFERENCE, "ideal", "", 60.0, 1000, GENERAL, profile())
    return replace(usual, **changed)


@cache
def profile() -> dict[str, Any]:
    return load("demo").model_dump(mode="json")


@cache
def paper() -> tuple[Prepared, statistics.Columns, np.ndarray]:
    ready = batch.prepare(plan(duration_s=42.0, population=tomllib.loads((POPULATIONS / "paper.toml").read_text())))
    walks = ready.walk(slice(0, 8))
    return ready, *statistics.of_walks(walks.t_s, walks.p_H, walks.p_R, ready.base.path, 1.0)


@pytest.mark.parametrize(
    ("controller", "varied"),
    [
        (Controller.REFERENCE, "delay_ms=0..60,k_c=50,400"),
        (Controller.LITERAL, "f_z=0.8..1.2,M_A=0.7..1.5,b_A=2..3,k_H=4..5"),
        (Controller.REGULATION, ""),
    ],
)
def test_a_crowd_walks_as_each_would_alone(controller, varied):
    """Start, saturated spring, stops and pushes, delays; the scalar loop runs the laws on plain floats."""
    eager = GENERAL | {"trial": GENERAL["trial"] | {"stop_probability": 0.7, "push_probability": 0.7}}
    eager["trial"] |= {"stop_start_s": 3.0, "push_start_s": {"low": 1.0, "high": 5.0}}
    ready = batch.prepare(
        plan(people=12, trials=1, duration_s=8.0, controller=controller, vary=varied, population=eager)
    )
    together = ready.walk(slice(0, 12))
    for i in (0, 5, 11):
        alone = ready.walk(i)
        assert np.array_equal(alone.t_s, together.t_s)
        for of_one, of_all in zip(alone[1:], together[1:], strict=True):
            assert np.max(np.abs(of_one - of_all[i])) < 1e-9
    assert np.ptp(together.p_H[:, -1, 0]) > 0.1


def test_behind_px4_like_vehicles_too():
    """Observer, noise, latencies and cascade included; and the vehicle is not where its reference is."""
    ready = batch.prepare(plan(people=6, trials=1, duration_s=4.0, robot="px4"))
    together, alone = ready.walk(slice(0, 6)), ready.walk(4)
    for of_one, of_all in zip(alone[1:], together[1:], strict=True):
        assert np.max(np.abs(of_one - of_all[4])) < 1e-9
    ideally = batch.prepare(plan(people=6, trials=1, duration_s=4.0)).walk(slice(0, 6))
    apart = norm(ideally.p_R - together.p_R)
    assert 0.005 < np.max(apart) < 0.3


def test_the_papers_people_walk_as_the_paper_says():
    _, columns, errors = paper()
    shared = statistics.common(errors)
    mean, std = np.nanmax(np.abs(shared.mean_m)), np.nanmax(shared.std_m)
    print(f"mean {100 * mean:.1f} cm, std {100 * std:.1f} cm, tube {100 * shared.tube_m:.1f} cm")
    assert mean < statistics.PAPER_MEAN_M
    assert 0.05 < std < statistics.PAPER_STD_M  # not by everybody walking alike
    assert shared.tube_m < statistics.PAPER_TUBE_M
    assert np.mean(columns["outward_m"]) > 0.02
    assert np.all(columns["arrival_s"] < 40.0)


def test_the_crowds_walk_is_the_one_of_the_reference_test():
    """The default person in the campaign and in tests/laws/ideal.py, whose integrator is another: to half a millimetre."""
    calm = GENERAL["person"] | {"m_H_kg": 5.0, "b_H_Ns_per_m": 8.0, "reaction": 0.0, "pull_threshold_N": 0.0}
    still = GENERAL["trial"] | {"veer": 0.0, "start_aside_m": 0.0, "stop_probability": 0.0, "push_probability": 0.0}
    ready = batch.prepare(plan(people=1, trials=1, duration_s=20.0, population={"person": calm, "trial": still}))
    there = ideal.paper_walk()
    here = ready.walk(slice(0, 1)).p_H[0]
    assert np.max(norm((here - there.p_H[::5][: len(here)])[:, :2])) < 1e-3


SHAPE = st.lists(st.floats(-0.4, 0.4), min_size=4, max_size=7)


@settings(max_examples=60)
@given(SHAPE, st.floats(0.0, 1.0), st.floats(-0.5, 0.5), st.floats(-1.5, 1.5))
def test_near_the_last_s_the_projection_is_the_least_in_its_window(offsets, guess, along, aside):
    """Newton from the guess, where it is proven, and the search, where not: both against brute force."""
    from services.guiding_controller.path import through

    path = through([(float(i), y) for i, y in enumerate(offsets)], 1.0, ideal.paper_path_cached().force)
    s = np.clip(guess + along / path.length_m, 0.0, 1.0)
    p_H = path.p(s) + aside * path.normal(s)
    window = np.clip(guess + np.linspace(-0.5, 0.5, 8001) / path.length_m, 0.0, 1.0)
    found = project(p_H, path, guess, 0.5)
    crowd = project(np.stack((p_H, path.p(guess))), path, np.full(2, guess), 0.5)
    least = np.min(norm((path.p(window) - p_H)[:, :2]))
    assert norm((path.p(found) - p_H)[:2]) <= least + 1e-6
    assert crowd[0] == pytest.approx(found, abs=1e-9)


def test_fewer_people_are_the_first_of_more_and_a_seed_is_a_seed():
    few, many = batch.prepare(plan(people=3)).columns, batch.prepare(plan(people=30)).columns
    for name in QUANTITIES:
        assert np.array_equal(few[name], many[name][:6])
    other = batch.prepare(plan(people=3, seed=2)).columns
    assert not np.array_equal(few["m_H_kg"], other["m_H_kg"])
    assert few["m_H_kg"][0] == few["m_H_kg"][1]
    assert few["veer"][0] != few["veer"][1]


@given(st.integers(0, 10**6))
def test_everybody_is_within_the_files_limits(seed):
    made, rng = population.build(GENERAL), np.random.default_rng(seed)
    columns = population.draw(made, rng.random((50, UNIFORMS)), rng.random((50, 2, UNIFORMS)))
    for name, drawn in (dict(made.person) | dict(made.trial)).items():
        known = columns[name][np.isfinite(columns[name])]
        assert np.all((known >= drawn.low) & (known <= drawn.high)), name
    share = np.mean(np.isfinite(columns["stop_start_s"]))
    assert 0.02 < share < 0.45


def test_a_cut_normal_has_the_mean_and_the_width_of_its_middle():
    made = population.spread("x", {"mean": 8.0, "std": 2.0, "low": 0.0, "high": 16.0}, ())
    u = (np.arange(20000) + 0.5) / 20000
    x = made.at(u, np.arange(20000))
    assert np.mean(x) == pytest.approx(8.0, abs=1e-3)
    assert np.std(x) == pytest.approx(2.0, abs=5e-3)


BAD = {
    "m_H_kg = 0.0": "person.m_H_kg = 0: must be > 0: everybody has a mass",
    "m_H_kg = { low = -1.0, high = 3.0 }": "person.m_H_kg = -1: must be > 0",
    "m_H_kg = { low = 3.0, high = 2.0 }": "person.m_H_kg.low = 3: must be at most high = 2",
    "m_H_kg = [5.0, nan]": "a finite number",
    'm_H_kg = "heavy"': "a finite number",
    "m_H_kg = { mean = 5.0 }": "low and high",
    "m_H_kg = 5.0\nb_H_Ns_per_m = -8.0": "b_H_Ns_per_m = -8: must be > 0: B_H must be positive definite",
    "m_H_kg = 5.0\nreaction = -1.0": "person.reaction = -1: must be > -1",
    "m_H_kg = 5.0\nmood = 1.0": "person.mood = 1.0: is not a known key",
    "m_H_kg = 5.0\nveer = 0.0": "veer: is there twice",
    "": "m_H_kg: is missing",
}


@pytest.mark.parametrize("line", BAD)
def test_an_impossible_population_is_one_clear_line(tmp_path, line):
    text = (POPULATIONS / "general.toml").read_text()
    kept = [
        row for row in text.splitlines() if row.split(" ")[0] not in {part.split(" ")[0] for part in line.split("\n")}
    ]
    kept = [row for row in kept if not row.startswith("m_H_kg")] + (["veer = 0.0"] if "veer" in line else [])
    file = tmp_path / "bad.toml"
    file.write_text("\n".join(kept).replace("[person] # drawn once for a person", f"[person]\n{line}"))
    with pytest.raises(ValueError, match=r"bad\.toml") as caught:
        population.read(file)
    assert BAD[line] in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_force_that_lifts_somebody_is_refused():
    with pytest.raises(ValueError, match=r"f_z_N = 30: must be below m_H g = .* of person \d"):
        batch.prepare(plan(people=50, vary="f_z=30"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("m_H=2..", "--vary m_H = '2..'"),
        ("m_H", "a name and = are needed"),
        ("colour=1", "--vary colour: must be one of"),
        ("k_c=0..100", "--vary k_c = 0: must be > 0"),
        ("b_H=-1,4", "B_H must be positive definite"),
        ("delay_ms=2000", "delay_ms = 2000: must be <= 1000"),
    ],
)
def test_what_cannot_be_varied_is_one_clear_line(text, message):
    with pytest.raises(ValueError, match="--vary") as caught:
        vary.parse(text)
    assert message in str(caught.value)


def test_a_range_and_a_list_are_shared_out_evenly():
    columns = batch.prepare(plan(people=40, vary="m_H=2..12,k_c=50,100,200,400,delay_ms=0..80")).columns
    parts = np.bincount(((columns["m_H_kg"][::2] - 2.0) / 10.0 * 40).astype(int), minlength=40)
    assert np.all(parts == 1)
    values, counts = np.unique(columns["k_c_N_per_m"][::2], return_counts=True)
    assert values.tolist() == [50.0, 100.0, 200.0, 400.0]
    assert np.all(counts == 10)
    assert set(columns["delay_ms"]) <= {10.0 * k for k in range(9)}
    assert abs(np.corrcoef(columns["m_H_kg"], columns["delay_ms"])[0, 1]) < 0.5


def test_statistics_of_walks_made_by_hand():
    path, s = ideal.paper_path_cached(), np.linspace(0.0, 1.0, 800)
    p_H = np.stack([path.p(s) + aside * path.normal(s) for aside in (0.08, -0.04)])
    columns, errors = statistics.of_walks(np.arange(0.0, 40.0, 0.05), p_H, p_H + [0.0, 0.0, 1.01], path, 1.0)
    assert columns["error_mean_m"] == pytest.approx([0.08, 0.04], abs=1e-3)
    assert columns["outward_m"] == pytest.approx([0.08, -0.04], abs=1e-3)  # the path bends to the right
    assert columns["end_error_m"] == pytest.approx([0.08, 0.04], abs=1e-6)
    assert np.all(columns["slack_fraction"] == 0.0)
    assert np.isfinite(columns["arrival_s"]).tolist() == [True, True]
    shared = statistics.common(errors)
    assert shared.mean_m[5:-5] == pytest.approx(0.02, abs=1e-3)
    assert shared.std_m[5:-5] == pytest.approx(0.12 / np.sqrt(2), abs=1e-3)
    assert shared.tube_m == pytest.approx(0.16, abs=2e-3)


def test_where_few_pass_there_is_no_mean_but_still_an_outermost():
    errors = np.array([[0.01, np.nan], [0.02, np.nan], [0.03, 0.2]])
    shared = statistics.common(errors)
    assert shared.mean_m == pytest.approx([0.02, np.nan], nan_ok=True)
    assert shared.high_m.tolist() == [0.03, 0.2]
    assert shared.tube_m == pytest.approx(0.4)


def test_a_persons_row_is_the_mean_of_their_walks():
    rows = statistics.persons(
        {"person": np.array([1.0, 1.0, 2.0]), "trial": np.zeros(3), "x": np.array([1.0, 3.0, np.nan])}
    )
    assert rows["walks"].tolist() == [2.0, 1.0]
    assert rows["x"] == pytest.approx([2.0, np.nan], nan_ok=True)
