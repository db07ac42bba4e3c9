"""Stamps across two hosts: whose clock, how old, and which commands are refused for it."""

import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.guidance import GuidanceCommand
from schemas.message import Vec3
from schemas.radio import RadioClock
from schemas.topics import GUIDANCE, HANDLE_STATE, RADIO_CLOCK
from schemas.tracking import HandleSource, HandleState
from services.runtime.hosts import AHEAD_ns, Hosts, Placement
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node
from services.runtime.virtual import VirtualClock, run_virtual

LEAD_ns = 7_000_000_000_000
GROUND = ("tracker", "guiding_controller", "ground_gateway")
DRONE = ("px4_bridge", "drone_gateway")
ON_DRONE = Placement(here="drone", elsewhere=GROUND, delay_allowed_s=0.05)
ON_GROUND = Placement(here="ground", elsewhere=DRONE, delay_allowed_s=0.05)
HAND = HandleState(position_m=Vec3(), velocity_mps=Vec3(), source=HandleSource.MOCAP, lag_s=0.0)
COMMAND = GuidanceCommand(
    s=0.1, path_length_m=4.0, p_H_d_m=Vec3(), p_R_d_m=Vec3(), f_d_N=Vec3(), scale=1.0, u_A_N=Vec3(), path_error_m=0.0
)


class AheadClock(VirtualClock):
    """The ground's."""

    def now_ns(self):
        return super().now_ns() + LEAD_ns


def comparison(lead_ns: int = LEAD_ns, *, valid: bool = True, uncertainty_s: float = 0.001):
    return RadioClock(
        valid=valid,
        ground_minus_drone_ns=lead_ns,
        uncertainty_s=uncertainty_s,
        round_trip_s=0.002,
        time_of_day_apart_s=0.0,
        up=True,
        connects=1,
        unanswered=0,
    )


def hosts():
    """The bridge on the drone, guidance and tracker on a ground whose clock is far ahead, and who compares clocks."""
    bus = MemoryBus()
    bridge = Node("px4_bridge", bus, VirtualClock(), placement=ON_DRONE)
    guiding = Node("guiding_controller", bus, AheadClock(), placement=ON_GROUND)
    gateway = Node("drone_gateway", bus, VirtualClock(), placement=ON_DRONE)
    return bridge, guiding, gateway.publisher(RADIO_CLOCK).publish


async def arrive():
    await asyncio.sleep(0.001)


@pytest.mark.parametrize("here", ["drone", "ground"])
@given(lead=st.integers(-(10**15), 10**15), stamp=st.integers(0, 10**15))
def test_a_stamp_of_the_other_host_comes_onto_this_ones_clock(here, lead, stamp):
    known = Hosts(ON_DRONE if here == "drone" else ON_GROUND)
    other, own = ("tracker", "px4_bridge") if here == "drone" else ("px4_bridge", "tracker")
    assert known.here_ns(other, stamp) is None
    known.note(comparison(lead))
    assert known.here_ns(own, stamp) == stamp
    assert known.here_ns(other, stamp) == (stamp - lead if here == "drone" else stamp + lead)
    known.note(comparison(0, valid=False))
    assert known.here_ns(other, stamp) != stamp or lead == 0


def test_on_one_host_every_stamp_is_its_own():
    alone = Hosts()
    assert not alone.two
    assert alone.here_ns("tracker", 5) == 5
    assert alone.allowance_ns("tracker") == 0


def test_before_the_clocks_are_compared_nothing_of_the_other_host_is_fresh_and_commands_are_refused():
    async def main():
        bridge, guiding, _ = hosts()
        tracker = Node("tracker", guiding.bus, AheadClock())
        hand, command = bridge.latest(HANDLE_STATE), bridge.latest(GUIDANCE)
        tracker.publisher(HANDLE_STATE).publish(HAND)
        guiding.publisher(GUIDANCE).publish(COMMAND)
        await arrive()
        assert hand.message is not None
        assert not hand.fresh
        assert hand.age_s == float("inf")
        assert command.message is None
        assert bridge.rejected == {GUIDANCE.key: 1}

    run_virtual(main())


def test_ages_are_right_once_they_are():
    async def main():
        bridge, guiding, compare = hosts()
        hand, command = bridge.latest(HANDLE_STATE), bridge.latest(GUIDANCE)
        tracker = Node("tracker", guiding.bus, AheadClock())
        compare(comparison())
        await arrive()
        tracker.publisher(HANDLE_STATE).publish(HAND)
        guiding.publisher(GUIDANCE).publish(COMMAND)
        await asyncio.sleep(0.03)
        assert hand.age_s == pytest.approx(0.03)
        assert command.age_s == pytest.approx(0.03)
        assert hand.fresh
        assert command.fresh
        await asyncio.sleep(HANDLE_STATE.timeout_s + 0.01)  # beyond the table's limit, within what the radio may add
        assert hand.fresh
        await asyncio.sleep(0.03)
        assert not hand.fresh

    run_virtual(main())


@pytest.mark.parametrize(
    ("age_s", "taken"),
    [(0.0, True), (0.148, True), (0.151, False), (60.0, False), (-0.02, True), (-0.03, False), (-60.0, False)],
)
def test_a_command_is_obeyed_while_it_lives_and_not_from_the_future(age_s, taken):
    assert AHEAD_ns == 20_000_000

    async def main():
        bridge, guiding, compare = hosts()
        command = bridge.latest(GUIDANCE)
        compare(comparison())
        await asyncio.sleep(100.0)
        stamp_ns = guiding.clock.now_ns() - round(age_s * 1e9)
        guiding.publisher(GUIDANCE).publish(COMMAND.model_copy(update={"stamp_ns": stamp_ns}))
        await arrive()
        assert (command.message is not None) is taken
        assert bridge.rejected == ({} if taken else {GUIDANCE.key: 1})

    run_virtual(main())


def test_a_replayed_recording_is_refused_sample_by_sample():
    async def main():
        bridge, guiding, compare = hosts()
        heard = list[bytes]()
        guiding.bus.subscribe(GUIDANCE.key, lambda _, payload: heard.append(payload))
        command = bridge.latest(GUIDANCE)
        compare(comparison())
        await arrive()
        for _ in range(50):
            guiding.publisher(GUIDANCE).publish(COMMAND)
            await asyncio.sleep(0.01)
            _ = command.message
        assert bridge.rejected == {}
        await asyncio.sleep(10.0)
        recorded, acted = list(heard), bridge.received[GUIDANCE.key]
        for payload in recorded:
            guiding.bus.put(GUIDANCE.key, payload, GUIDANCE.stance)
        await arrive()
        assert command.value is None
        assert bridge.received[GUIDANCE.key] == acted
        assert bridge.rejected == {GUIDANCE.key: len(recorded)}

    run_virtual(main())
