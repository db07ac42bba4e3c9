"""What a gateway tells: who is connected, who was refused, and how far the clocks are apart, also when one begins anew."""

import asyncio
import json
from collections.abc import Callable
from contextlib import suppress

from schemas.topics import RADIO_CLOCK
from services.config import load
from services.gateway import service
from services.gateway.refusals import Refusals
from services.gateway.service import Remotes
from services.runtime.memory_bus import MemoryBus
from services.runtime.node import Node
from services.runtime.virtual import VirtualClock, run_virtual

CONFIG = load("drone")
WAY_s = 0.02
PREFIX, ACCESS = "clew/@v1/t/", "zenoh::net::routing::interceptor::access_control"


class RadioMemoryBus(MemoryBus):
    """A memory bus with the ground's clock at the far end of a radio."""

    log = None

    def __init__(self, lead_ns: int):
        super().__init__()
        self.lead_ns, self.up, self.clock = lead_ns, True, VirtualClock()

    def ask(self, key: str, on_reply: Callable[[bytes, int], None], timeout_s: float) -> None:
        def answer():
            said = json.dumps([self.clock.now_ns() + self.lead_ns, 0]).encode()
            loop.call_later(WAY_s, lambda: on_reply(said, self.clock.now_ns()))

        loop = asyncio.get_running_loop()
        if self.up:
            loop.call_later(WAY_s, answer)

    def remotes(self) -> dict[str, tuple[str, int]]:
        return {"1": ("ground:ground", 4)} if self.up else {}


def test_the_drones_gateway_follows_the_grounds_clock_and_its_restart():
    async def main():
        bus = RadioMemoryBus(lead_ns=123_456_789_000)
        clock = Node("px4_bridge", bus, VirtualClock(), observer=True).latest(RADIO_CLOCK)
        running = asyncio.create_task(service.run(Node("drone_gateway", bus, VirtualClock()), CONFIG))
        await asyncio.sleep(0.15)
        assert clock.message is None or not clock.message.valid
        await asyncio.sleep(3.0)
        known = clock.message
        assert known is not None
        assert known.valid
        assert known.up
        assert abs(known.ground_minus_drone_ns - 123_456_789_000) <= 1000
        assert WAY_s <= known.uncertainty_s < 1.1 * WAY_s
        bus.up = False
        await asyncio.sleep(30.0)
        known = clock.message
        assert known is not None
        assert known.valid
        assert not known.up
        assert known.unanswered >= 55
        assert known.uncertainty_s > WAY_s + 0.9 * 30.0 * 1e-4
        bus.up, bus.lead_ns = True, 5_000_000_000
        await asyncio.sleep(3.0)
        known = clock.message
        assert known is not None
        assert abs(known.ground_minus_drone_ns - 5_000_000_000) <= 1000
        assert known.connects == 2
        running.cancel()
        with suppress(asyncio.CancelledError):
            await running

    run_virtual(main())


def test_strangers_twins_and_lost_links_are_named():
    assert CONFIG.radio is not None
    watch = Remotes(CONFIG.radio)
    ground, screen = ("ground:ground", 4), ("viewer:screen", 1)
    assert watch.tell({}) == "radio: nobody"
    assert watch.tell({"1": ground, "2": screen}) == "radio: ground:ground, viewer:screen"
    assert "SHUT OUT, not in radio.names: viewer:old" in watch.tell({"1": ground, "3": ("viewer:old", 1)})
    drone = ("drone:drone", 4)
    assert "TWO HOSTS are drone:drone: check system.host" in watch.tell({"1": drone, "2": drone})
    console = ("operator:console", 1)
    assert "TWO" not in watch.tell({"1": console, "2": console})
    assert watch.connects == 4
    assert watch.tell({"1": ("drone:drone", 3)}) == "radio: drone:drone; drone:drone by 3 of 4 links only"


def from_log(target: str, text: str, level: str = "WARN") -> str:
    return f"2026-11-24T19:35:58.331140Z  {level} rx-5 ThreadId(07) {target}: {text}"


def test_what_zenoh_says_of_a_refused_session_is_counted():
    refusals = Refusals(PREFIX)
    assert str(refusals) == ""
    tls, quic = "zenoh_link_tls::unicast", "zenoh_link_commons::quic::unicast"
    assert refusals.note(from_log(tls, "peer sent no certificates. Hint: x"))
    assert refusals.note(from_log("zenoh::api::session", "Received Data for unknown expr_id: 1", "ERROR"))
    assert str(refusals) == "1 sessions refused (peer sent no certificates)"
    failed = "QUIC acceptor failed: "
    why = 'TransportError(Error { code: Code::crypto(2d), frame: None, reason: "invalid peer certificate: Expired" }) Hint: x'
    refusals.note(from_log(quic, failed + why))
    assert str(refusals) == "2 sessions refused (invalid peer certificate: Expired)"
    gave_up = (
        'ConnectionClosed(ConnectionClose { error_code: APPLICATION_ERROR, frame_type: None, reason: b"" }) Hint: x'
    )
    refusals.note(from_log(quic, failed + gave_up))
    assert refusals.sessions == 2, "who gave up was not refused"


def test_a_deed_that_the_access_rules_refuse_is_counted_by_name_and_their_look_ups_are_not():
    """As Zenoh 1.10 logs it: the session has two links, so what is not remembered of a key is said twice."""
    refusals = Refusals(PREFIX)
    subjects = [
        f"a1 on Interface(radio)+CertCommonName(viewer:screen)+Transport({link})+a1" for link in ("Quic", "Tls")
    ]

    def said(*texts: str) -> str:
        assert not any(refusals.note(from_log(ACCESS, text, "TRACE")) for text in texts), "a line for each message"
        return str(refusals)

    key = f"{PREFIX}guidance/command"
    looked_up = [
        f"{who} is unauthorized to {what} (ingress) on {key}" for what in ("Query", "Put", "Delete") for who in subjects
    ]
    assert said(f"ACL (ingress): caching permissions for `{key}` ...", *looked_up) == ""
    assert said(f"Using cached result: a1 is authorized to Put (egress) on {key}") == ""
    assert said(f"Using cached result: a1 is unauthorized to Put (ingress) on {key}") == (
        "1 times denied (put guidance/command by viewer:screen)"
    )
    said(*(f"{who} is unauthorized to Put (ingress) on {PREFIX}**" for who in subjects))
    said(*(f"{who} is unauthorized to Liveliness Token (ingress) on {PREFIX}@alive/px4_bridge" for who in subjects))
    assert refusals.denied == {
        "put guidance/command by viewer:screen": 1,
        "put another key by viewer:screen": 1,
        "token @alive/px4_bridge by viewer:screen": 1,
    }
