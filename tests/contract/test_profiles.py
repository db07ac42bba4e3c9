"""A profile that builds on another: what it says is laid over it, and a fault is told in the file where it stands."""

from pathlib import Path

import pytest

from services.config import ConfigError, load
from services.profile_file import layered


def written(folder: Path, name: str, text: str) -> Path:
    file = folder / f"{name}.toml"
    file.write_text(text)
    return file


def refused(file: Path) -> str:
    with pytest.raises(ConfigError) as why:
        load(str(file))
    (line,) = str(why.value).splitlines()
    return line


def test_only_what_is_said_changes(tmp_path):
    file = written(tmp_path, "slow", 'base = "demo"\n[px4_bridge.limits]\nv_max_mps = 0.7\n')
    slow, demo = load(str(file)), load("demo")
    assert slow.px4_bridge.limits.v_max_mps == 0.7
    changed = slow.model_dump()
    changed["px4_bridge"]["limits"]["v_max_mps"] = demo.px4_bridge.limits.v_max_mps
    assert changed == demo.model_dump()


def test_layers_may_be_several_and_the_last_word_counts(tmp_path):
    middle = written(tmp_path, "middle", 'base = "demo"\n[guiding_controller]\nramp_s = 3.0\nf_z_N = 1.2\n')
    top = written(tmp_path, "top", f'base = "{middle}"\n[guiding_controller]\nramp_s = 4.0\n')
    config = load(str(top))
    assert (config.guiding_controller.ramp_s, config.guiding_controller.f_z_N) == (4.0, 1.2)


def test_a_list_is_replaced_not_joined(tmp_path):
    file = written(tmp_path, "few", 'base = "demo"\n[system]\nservices = ["recorder", "tracker"]\n')
    assert load(str(file)).system.services == ("recorder", "tracker")


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("[guiding_controller]\nramp_s = -1.0\n", "top"),
        ("[world]\nhandle_mass_kg = 0.08\n", "top"),  # a limit across sections
        ("[guiding_controller]\nramps = 1.0\n", "top"),
    ],
)
def test_a_fault_is_told_in_the_file_that_has_it(tmp_path, text, where):
    middle = written(tmp_path, "middle", 'base = "demo"\n' + text)
    top = written(tmp_path, "top", f'base = "{middle}"\n[system]\nseed = 2\n')
    assert refused(top).startswith(f"{middle}: ")
    alone = written(tmp_path, where, 'base = "demo"\n' + text)
    assert refused(alone).startswith(f"{alone}: ")


def test_a_missing_key_is_missed_in_the_table_that_lacks_it(tmp_path):
    sitl = '[simulator.px4_sitl]\nbinary = ""\ninstance = 0\nairframe = "none_iris"\n[simulator.px4_sitl.parameters]\n'
    file = written(tmp_path, "sitl", 'base = "demo"\n' + sitl)
    assert refused(file) == f"{file}: simulator.px4_sitl.appears_s: is missing"


def test_an_unknown_base_and_a_circle_are_refused(tmp_path):
    lost = written(tmp_path, "lost", 'base = "nowhere"\n')
    assert refused(lost).startswith(f"{lost}: base = nowhere: no such file")
    one, other = tmp_path / "one.toml", tmp_path / "other.toml"
    one.write_text(f'base = "{other}"\n')
    other.write_text(f'base = "{one}"\n')
    assert refused(one) == f"{other}: base = {one}: builds on itself"
    number = written(tmp_path, "number", "base = 3\n")
    assert refused(number) == f"{number}: base = 3: must be the name of a profile, or a file"


def test_every_key_knows_its_file(tmp_path):
    file = written(tmp_path, "slow", 'base = "demo"\n[system]\nname = "slow"\n')
    written_in = layered(file).written
    assert written_in["system.name"] == file
    assert written_in["system.seed"].name == "demo.toml"


def test_a_program_that_cannot_run_is_refused_before_anything_starts(tmp_path):
    with pytest.raises(
        ConfigError, match=r"PX4's program \(--px4 or PX4_BIN\) = .*nothing: must be a file that can be run"
    ):
        load("px4-sitl", px4=str(tmp_path / "nothing"))
    assert load("demo", px4=str(tmp_path / "nothing")).simulator.px4_sitl is None


@pytest.mark.parametrize("name", ["drone", "ground"])
def test_a_pilots_kill_switch_counts_on_hardware(name):
    """PX4 looks at the radio control's switches only where that may be its source; its way back must not start the motors."""
    px4 = load(name).px4_bridge.px4
    assert (px4["COM_RC_IN_MODE"], px4["COM_KILL_DISARM"]) == (0, 0.0)
