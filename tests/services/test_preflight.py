"""What stands against a flight: the list itself, and on the stand-in autopilot."""

import asyncio
import socket

import pytest

from schemas.vehicle import ThrustSource
from services.config import load
from services.console.preflight import look, posing, preflight
from services.px4_bridge.preflight import Estimate, Found, Identity, Thrust, Wanted, differing, reasons
from services.rehearsal.direct_vehicle import DirectVehicle
from services.simulator import service as simulator
from services.simulator.commander import SetParameter
from tests.services.alone import Alone, alone

CONFIG = load("demo")
WANTED = CONFIG.px4_bridge.px4


SOUND = Found(
    identity=Identity(12, 2, (1, 17, 0)),
    parameters=WANTED,
    refused=(),
    armed=False,
    specific_force_mps2=9.81,
    poses=100,
    estimate=Estimate(True, 0.005, 0.004),
    arming=(),
    battery_fraction=0.9,
    pilot=False,
)
RIGHT = Wanted(WANTED, Thrust(ThrustSource.ACTUATOR_OUTPUTS, 0.005, False, True), 0.8, 1.5, 0.3)


def against(battery=0.9, armed=False, **changed):
    parameters = {name: value for name, value in (WANTED | changed).items() if value is not None}
    return reasons(SOUND._replace(parameters=parameters, armed=armed, battery_fraction=battery), RIGHT)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"identity": Identity(3, 2, (1, 17, 0))}, "the autopilot is no PX4 (MAV_AUTOPILOT = 3)"),
        ({"identity": Identity(12, 1, (1, 17, 0))}, "the vehicle is no quadrotor (MAV_TYPE = 1, must be 2)"),
        ({"identity": Identity(12, 2, (1, 14, 3))}, "PX4's version is 1.14.3, at least 1.15.0"),
        ({"identity": Identity(12, 2, (0, 0, 0))}, "PX4's version is not told, at least 1.15.0"),
        ({"refused": ["parameter X = 1: does_not_exist"]}, "parameter X = 1: does_not_exist"),
        ({"specific_force_mps2": 0.0}, "no inertial samples"),
        ({"specific_force_mps2": 8.5}, "at rest the accelerometer reads 8.50 m/s²: 1.05 N of bias"),
        ({"poses": 0}, "no poses from motion capture: it cannot know where it is"),
        ({"estimate": Estimate(False, 0.0, 0.0)}, "the autopilot has no position"),
        ({"estimate": Estimate(True, 0.2, 0.01)}, "its position is uncertain by 0.200 m, height by 0.010 m"),
        ({"arming": ["Heading estimate not stable"]}, "PX4: Heading estimate not stable"),
    ],
)
def test_each_thing_that_is_wrong_is_told(change, told):
    assert [what for what, _ in reasons(SOUND._replace(**change), RIGHT)] == [told]


@pytest.mark.parametrize(
    ("thrust", "told"),
    [
        (Thrust(ThrustSource.ESC_RPM, 0.0, False, False), ["thrust by esc_rpm is not calibrated"]),
        (
            Thrust(ThrustSource.ESC_RPM, 0.03, False, True),
            ["thrust by esc_rpm is wrong by 3.0 %, at most 2 % (0.24 N)"],
        ),
        (Thrust(ThrustSource.ACTUATOR_OUTPUTS, 0.0, True, False), []),
    ],
)
def test_a_real_vehicle_wants_a_calibrated_thrust(thrust, told):
    assert [what for what, _ in reasons(SOUND, RIGHT._replace(thrust=thrust))] == told


@pytest.mark.parametrize(("name", "value"), [("COM_OBL_RC_ACT", 0), ("COM_OBL_RC_ACT", 99), ("COM_OF_LOSS_T", 5.0)])
def test_a_profile_that_would_fly_on_or_climb_again_is_told_too(name, value):
    wrong = WANTED | {name: value}
    ((what, _),) = reasons(SOUND._replace(parameters=wrong), RIGHT._replace(parameters=wrong))
    assert what.startswith(f"the profile's {name} = {value}: must be")


def test_a_vehicle_that_is_set_as_the_profile_wants_may_fly():
    assert against() == []


@pytest.mark.parametrize(
    ("channel", "heard", "told"),
    [
        (5, True, []),
        (0, True, ["RC_MAP_KILL_SW = 0: no channel of the radio control is a kill switch"]),
        (5, False, ["PX4 hears no pilot's radio control"]),
    ],
)
def test_where_a_pilot_counts_there_must_be_a_kill_switch_that_is_heard(channel, heard, told):
    heeds = WANTED | {"COM_RC_IN_MODE": 0}
    found = SOUND._replace(parameters=heeds | {"RC_MAP_KILL_SW": channel}, pilot=heard)
    assert [what for what, _ in reasons(found, RIGHT._replace(parameters=heeds))] == told


@pytest.mark.parametrize("value", [0, 99])
def test_a_wrong_parameter_is_told_with_both_values_and_what_it_does(value):
    """PX4 takes a value that its own list does not have without a word: the comparison is with the one that is wanted."""
    ((what, cure),) = against(COM_OBL_RC_ACT=value)
    assert what.startswith(f"COM_OBL_RC_ACT = {value}, the profile wants 4 (what it does then")
    assert cure == "--fix sets it"


def test_what_is_wrong_comes_in_the_order_in_which_to_mend_it():
    listed = [what.split()[0] for what, _ in against(battery=0.1, armed=True, EKF2_EV_CTRL=0, MPC_USE_HTE=None)]
    assert listed == ["the", "MPC_USE_HTE:", "EKF2_EV_CTRL", "battery"]


@pytest.mark.parametrize(("found", "same"), [(0.01, True), (0.009999999776482582, True), (0.0101, False)])
def test_a_float_is_compared_as_the_autopilot_keeps_it(found, same):
    assert (differing({"EKF2_EVP_NOISE": found}, {"EKF2_EVP_NOISE": 0.01}) == {}) == same


def preflights(*fixes, refuses=(), wanted=None):
    """The lists of several looks in a row, on a stand-in whose MPC_USE_HTE is wrong."""
    listed, vehicles = [], []
    told = CONFIG.simulator.autopilot.px4 | {"MPC_USE_HTE": 1}
    profile = CONFIG.model_copy(deep=True)
    profile.px4_bridge.px4.update(wanted or {})

    async def play(stage: Alone) -> None:
        wrong = CONFIG.model_copy(deep=True)
        wrong.simulator.autopilot.px4.update(told)
        vehicles.append(DirectVehicle(CONFIG.px4_bridge.vehicle, stage.clock.now_ns))
        vehicles[0].refuses = refuses
        await simulator.play(stage.node("simulator"), wrong, vehicles[0])

    async def script(stage: Alone) -> None:
        await asyncio.sleep(1.5)
        async with posing(CONFIG, stage.node("tracker"), vehicles[0]) as poses:
            for fix in fixes:
                listed.append(await look(profile, vehicles[0], poses, fix=fix))

    alone(play, {}, script)
    return listed


def test_fix_sets_what_differs_and_without_it_nothing_is_touched():
    first, second, third = preflights(False, True, False)
    assert [what.split()[0] for what, _ in first] == ["MPC_USE_HTE"]
    assert second == []
    assert third == []


def test_what_the_autopilot_refuses_is_told_and_still_differs():
    """Told once as refused and once as it is: what it says it has is asked for again after setting."""
    ((refused, _), (differs, cure)) = preflights(True, refuses=(SetParameter,))[0]
    assert refused == "parameter MPC_USE_HTE = 0: denied by the autopilot"
    assert differs.startswith("MPC_USE_HTE = 1, the profile wants 0")
    assert cure == "--fix sets it"


def test_a_value_that_is_taken_and_kept_otherwise_is_not_believed_to_be_set():
    """An integer there drops the half without a word."""
    ((what, _),) = preflights(True, wanted={"EKF2_HGT_REF": 2.5})[0]
    assert what.startswith("EKF2_HGT_REF = 2, the profile wants 2.5")


def test_without_an_autopilot_that_is_the_one_reason(tmp_path, capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        url = f"udpin://127.0.0.1:{probe.getsockname()[1]}"
    file = tmp_path / "alone.toml"
    file.write_text(f'base = "demo"\n[px4_bridge.link]\nurl = "{url}"\ntimeout_s = 0.3\n')
    assert preflight(str(file), fix=False) == 1
    first, last = capsys.readouterr().out.splitlines()
    assert (
        first == f"1. no autopilot on {url} within 0.3 s: check power, cable, port and baud rate of px4_bridge.link.url"
    )
    assert last == "1 against a flight"


def test_a_wrong_profile_is_told_before_anybody_is_asked(capsys):
    assert preflight("nowhere", fix=False) == 2
    assert "nowhere: no such file" in capsys.readouterr().err
