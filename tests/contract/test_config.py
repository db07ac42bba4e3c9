"""A wrong value is one line: file, key, value, limit; and nothing has started."""

import re

import pytest

from services.config import Config, ConfigError, load, told_in
from services.profile_file import deploy_folder

DEMO = (deploy_folder() / "profiles" / "demo.toml").read_text()
PAPER = (deploy_folder() / "paths" / "paper.toml").read_text()


def refusal(folder, *changes, path=""):
    """The one line that a changed demo profile, or path, is refused with."""
    profile, file = DEMO, folder / "path.toml"
    for old, new in changes:
        assert old in profile, old
        profile = profile.replace(old, new, 1)
    (folder / "profile.toml").write_text(profile)
    if path:
        file.write_text(path)
    with pytest.raises(ConfigError) as refused:
        load(str(folder / "profile.toml"), path=str(file) if path else "")
    (line,) = str(refused.value).splitlines()
    return line


def test_every_profile_of_the_house_loads():
    for file in (deploy_folder() / "profiles").glob("*.toml"):
        if file.stem in ("two_hosts", "hardware"):  # the bases of others
            with pytest.raises(ConfigError, match=r"system.host = '': must be one of drone, ground, console$"):
                load(file.stem)
        else:
            assert load(file.stem).system.services or load(file.stem).system.host == "console"


@pytest.mark.parametrize("path", ["paper", "straight", "s_bend"])
@pytest.mark.parametrize("person", ["default", "lets_go"])
def test_paths_and_people_combine(path, person):
    assert load("demo", path=path, person=person).guided_path.name == path


@pytest.mark.parametrize(
    ("old", "new", "key", "value", "limit"),
    [
        ("f_z_N = 1.0", "f_z_N = 60.0", "guiding_controller.f_z_N", "60.0", "49.03 N"),
        ("f_z_N = 1.0", "f_z_N = -1.0", "guiding_controller.f_z_N", "-1.0", "greater than 0"),
        ("f_z_N = 1.0", "f_z_N = nan", "guiding_controller.f_z_N", "nan", "finite"),
        ("f_z_N = 1.0", 'f_z_N = "one"', "guiding_controller.f_z_N", "'one'", "number"),
        ("f_z_N = 1.0", "f_z_newton = 1.0\nf_z_N = 1.0", "guiding_controller.f_z_newton", "1.0", "not a known key"),
        ("f_z_N = 1.0", "", "guiding_controller.f_z_N", "", "missing"),
        ("[world]", "[word]\nx = 1\n[world]", "word", "", "not a known key"),
        ("b_A_Ns_per_m = 2.4", "M_A_kg = 0.5\nb_A_Ns_per_m = 2.4", "px4_bridge.admittance.M_A_kg", "0.5", "0.9"),
        ("handle_mass_kg = 0.03", "handle_mass_kg = 0.08", "handle_mass_kg", "0.08", "0.05"),
        ("capacity_J = 8.0", "capacity_J = 5.0", "px4_bridge.tank.capacity_J", "5.0", "at least 6.13 J"),
        ('"recorder", "simulator"', '"recorder", "simulater"', "system.services", "simulater", "tracker"),
        ("volume_max_m = [5.0, 3.0, 3.0]", "volume_max_m = [1.0, 3.0, 3.0]", "path.waypoints_m", "", "outside"),
    ],
)
def test_a_wrong_value_is_named_with_its_file_and_limit(tmp_path, old, new, key, value, limit):
    line = refusal(tmp_path, (old, new))
    assert key.split(".")[-1] in line
    assert value in line
    assert limit in line
    assert ".toml" in line


@pytest.mark.parametrize(
    ("old", "new", "key", "limit"),
    [
        (
            "[[-2.0, -0.5], [-1.0, -0.03], [0.0, 0.25], [1.0, 0.2], [2.0, 0.0]]",
            "[[0, 0], [0.1, 0], [0.2, 0]]",
            "waypoints_m",
            "0.5 m",
        ),
        (
            "[[-2.0, -0.5], [-1.0, -0.03], [0.0, 0.25], [1.0, 0.2], [2.0, 0.0]]",
            "[[0, 0], [2, 0], [1, 1.5], [1, -1.5]]",
            "waypoints_m",
            "crosses itself",
        ),
        (
            "[[-2.0, -0.5], [-1.0, -0.03], [0.0, 0.25], [1.0, 0.2], [2.0, 0.0]]",
            "[[0, 0], [1, 0]]",
            "waypoints_m",
            "at least 3",
        ),
        ("ramp_down_fraction = 0.15", "ramp_down_fraction = 0.0", "ramp_down_fraction", "end at zero"),
        ("f_start_N = 0.75", "f_start_N = 0.0", "f_start_N", "> 0"),
        ("name = ", "nam = ", "nam", "unknown key"),
    ],
)
def test_an_unfit_path_is_refused(tmp_path, old, new, key, limit):
    assert old in PAPER
    line = refusal(tmp_path, path=PAPER.replace(old, new))
    assert str(tmp_path / "path.toml") in line
    assert key in line
    assert limit in line


def test_broken_toml_says_where(tmp_path):
    assert re.search(r"profile\.toml.*line \d+", refusal(tmp_path, ("[world]", "[world")))


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(ConfigError, match="demo"):
        load("nonsense")
    with pytest.raises(ConfigError, match="straight"):
        load("demo", path="nonsense")


def test_what_is_derived_can_be_overridden(tmp_path):
    assert load("demo").force_estimator.observer.m_R_kg == load("demo").vehicle.quadrotor.mass_kg
    text = DEMO.replace("bandwidth_Hz = 8.0", "m_R_kg = 0.9\nbandwidth_Hz = 8.0", 1)
    (tmp_path / "wrong_belief.toml").write_text(text)
    assert load(str(tmp_path / "wrong_belief.toml")).force_estimator.observer.m_R_kg == 0.9


def test_the_resolved_configuration_survives_its_file(tmp_path):
    config = load("demo")
    (tmp_path / "config.json").write_text(config.model_dump_json())
    again = load(str(tmp_path / "config.json"))
    assert isinstance(again, Config)
    assert again.model_dump() == config.model_dump()


def test_a_profile_over_a_base_replaces_single_values_and_whole_lists(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('base = "demo"\n[system]\nname = "mine"\nservices = ["tracker"]\n[tracker.handle]\nlost_s = 0.7\n')
    mine, demo = load(str(file)), load("demo")
    assert (mine.system.name, mine.system.services) == ("mine", ("tracker",))
    assert mine.tracker.handle.lost_s == 0.7
    assert mine.tracker.handle.tau_s == demo.tracker.handle.tau_s
    file.write_text('base = "nowhere"\n')
    with pytest.raises(ConfigError, match=r"mine.toml: base = nowhere: no such file"):
        load(str(file))


@pytest.mark.parametrize(
    ("mine", "complaint"),
    [
        (
            "[hosts.drone]\nservices = ['drone_gateway', 'trakcer']",
            "mine.toml: hosts.drone.services: trakcer: must be one",
        ),
        ("[hosts.drone]\nservices = 'tracker'", "mine.toml: hosts.drone.services"),
        ("[hosts.drone]\nservices = ['drone_gateway', 3]", "mine.toml: hosts.drone.services.1 = 3"),
        (
            "[hosts.drone]\nservices = ['drone_gateway', 'tracker']",
            "mine.toml: hosts.drone.services: tracker runs twice",
        ),
        ("[radio]\nports = [7447, 7448, 7449, 0]", "mine.toml: radio.ports.3 = 0"),
        ("[radio]\nnames = ['boss:me']", "mine.toml: radio.names: 'boss:me': must be role:name"),
        ("", "ground.toml: system.host = 'moon'"),
    ],
)
def test_a_fault_of_two_hosts_is_told_once_in_the_file_where_it_stands(tmp_path, mine, complaint):
    ground = tmp_path / "ground.toml"
    ground.write_text(f'base = "two_hosts"\n[system]\nhost = "{"ground" if mine else "moon"}"\n')
    file = tmp_path / "mine.toml"
    file.write_text(f'base = "{ground}"\n{mine}\n')
    with pytest.raises(ConfigError) as told:
        load(str(file))
    assert str(told.value).startswith(f"{tmp_path}/{complaint}")
    assert "\n" not in str(told.value)


def test_a_fault_that_is_found_later_is_told_in_the_file_that_says_its_key(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('base = "ground"\n')
    for fault in ("radio.address = clew-ground: does not resolve", "radio.names: 0 names of role drone: must be one"):
        with pytest.raises(ConfigError, match=rf"profiles/two_hosts.toml: {fault}$"), told_in(str(file)):
            raise ConfigError(fault)
    with pytest.raises(ConfigError, match=r"^/x/ca.pem: is missing$"), told_in(str(file)):
        raise ConfigError("/x/ca.pem: is missing")


@pytest.mark.parametrize("kind", ["", "-sim"])
def test_both_hosts_of_a_pair_agree_on_everything_but_which_they_are(kind):
    drone, ground = load(f"drone{kind}").model_dump(), load(f"ground{kind}").model_dump()
    assert (drone["system"].pop("host"), ground["system"].pop("host")) == ("drone", "ground")
    assert not set(drone["system"].pop("services")) & set(ground["system"].pop("services"))
    assert drone == ground


def test_on_hardware_nothing_is_simulated_and_each_host_has_what_it_needs():
    drone, ground = load("drone").system.services, load("ground").system.services
    assert "simulator" not in (*drone, *ground)
    assert {"px4_bridge", "force_estimator", "safety_supervisor"} <= set(drone)
    assert {"tracker", "guiding_controller"} <= set(ground)
    assert load("ground").tracker.mocap is not None


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ('[tracker]\nsource = "vicom"\n', "tracker.source = 'vicom': must be one of simulated, vicon, optitrack"),
        ('[tracker.mocap.handle]\nbody = "robot"\n', "tracker.mocap.handle.body = 'robot': is the robot's too"),
        ("[tracker.mocap]\nrate_max_Hz = 40.0\n", "tracker.mocap.rate_max_Hz = 40.0: must be above rate_min_Hz = 50.0"),
        ("[tracker.mocap]\nhost = 7\n", "tracker.mocap.host = 7: must be a valid string"),
        ("[tracker.mocap.robot]\noffset_m = [0.0]\n", "tracker.mocap.robot.offset_m.1: is missing"),
    ],
)
def test_a_capture_system_that_cannot_be_is_refused(tmp_path, changes, fault):
    file = tmp_path / "lab.toml"
    file.write_text(f'base = "ground"\n{changes}')
    with pytest.raises(ConfigError) as why:
        load(str(file))
    assert str(why.value).splitlines()[0].startswith(f"{file}: {fault}")


def test_a_capture_system_without_its_section_is_refused(tmp_path):
    file = tmp_path / "lab.toml"
    file.write_text('base = "demo"\n[tracker]\nsource = "vicon"\n')
    with pytest.raises(ConfigError, match=r"tracker.mocap: is missing, for tracker.source = 'vicon'"):
        load(str(file))
