"""COMMAND_LONG as the stand-in autopilot understands it; pure."""

import math

from services.simulator.commander import Arm, Mode, Request, Switch, Terminate, Unsupported
from services.simulator.mavlink_streams import CUSTOM_MODE

_LAND, _SET_MODE, _TERMINATE, _ARM = 21, 176, 185, 400
_FORCE = 21196  # the magic number of a forced disarm
_MODES = {code: mode for mode, code in CUSTOM_MODE.items() if mode is not Mode.DESCEND}


def request(command: int, first: float, second: float, third: float) -> Request | None:
    """What is asked for by the command's first parameters, its ticket the command's number; None: not of the autopilot."""
    if command == _ARM:
        return Arm(first > 0.5, second == _FORCE, command)
    if command == _SET_MODE:
        mode = _MODES.get(whole(second) << 16 | whole(third) << 24)
        return Switch(mode, command) if mode else Unsupported(command)
    if command == _LAND:
        return Switch(Mode.LAND, command)
    return Terminate(command) if command == _TERMINATE else None


def whole(value: float) -> int:
    """A parameter that is a number of something; NaN, which is not set, is 0."""
    return 0 if math.isnan(value) else int(value)
