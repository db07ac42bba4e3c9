"""A person's commands from another shell, while it flies; and a host whose processors are all busy."""

import asyncio
import json
import re
import sys

from schemas.safety import Level, Phase
from services.faults.campaign import processors
from tests.net.two_hosts import read_until
from tests.processes import host, promises
from tests.processes.system import System, fly
from tests.system.demo_profile import clew, run, write_profile

BUSY_S = 3.0


def test_stop_hold_and_land_from_another_shell(tmp_path):
    async def script(system: System) -> None:
        await system.reach(Phase.GUIDING)
        for word, level in (("stop", Level.EASE), ("hold", Level.HOLD)):
            await system.pulled()
            async with system.broken() as window:
                code, told = await system.clew(word)
                asked_s = window.age_s
                await asyncio.sleep(0.5)
            assert code == 0, told
            promises.assert_pulled(window)
            promises.assert_backs_off(window, asked_s)
            assert max(window.levels()) == level, window
            code, told = await system.clew("resume")
            assert code == 0, told
        await system.pulled()
        async with system.broken() as window:
            code, told = await system.clew("land")
            assert code == 0, told
            await system.landed()
            await system.until(lambda: system.phase is Phase.LANDED, "told as landed")
        assert Phase.CLEARING in window.phases(), window
        promises.assert_force(window)

    fly(tmp_path, script)


def test_kill_from_another_shell_while_the_demo_flies(tmp_path):
    """The demo as a user starts it. It ends by itself, and says that this was no good flight."""
    profile = str(write_profile(tmp_path))
    demo = clew(tmp_path, "demo", "--no-live", "--profile", profile)
    try:
        read_until(demo, "zeroing", 60.0)
        killed = run(tmp_path, "kill", "--profile", profile)
        _, errors = demo.communicate(timeout=60.0)
    finally:
        demo.kill()
        demo.communicate()
    assert killed.returncode == 0, killed.stdout + killed.stderr
    assert re.search(r"kill: the motors are off after \d+ ms", killed.stdout)
    assert demo.returncode == 1, errors
    summary = json.loads((tmp_path / "sessions/latest/summary.json").read_text())
    assert "the session ended in phase killed, not landed" in summary["reasons"]


def test_processors_starved_by_busy_loops(tmp_path):
    """Two on each. Where the loops go before them nobody notices; where they do not, nobody is pulled harder than before."""

    async def script(system: System) -> None:
        await system.guided()
        async with system.broken() as window:
            await busy()
        promises.assert_pulled(window)
        promises.assert_force(window)
        if host.may_go_first():
            promises.assert_unnoticed(window)
        await system.pulled()
        for name in system.config.system.services:
            host.go_with_the_others(system.pid(name))
        async with system.broken() as window:
            await busy()
        promises.assert_force(window)
        assert set(window.phases()) <= {Phase.GUIDING, Phase.HOLD, Phase.CLEARING, Phase.LANDING}, window

    fly(tmp_path, script)


async def busy() -> None:
    """Two busy loops on each processor, for a while, as everybody may have them."""
    command = ("chrt", "-o", "0", sys.executable, "-c", "while True: pass")
    loops = [await asyncio.create_subprocess_exec(*command) for _ in range(2 * processors())]
    await asyncio.sleep(BUSY_S)
    for loop in loops:
        loop.kill()
        await loop.wait()
