"""The pilot's radio control as PX4's simulator port takes it: four sticks, and a kill switch on the fifth channel."""

from dataclasses import dataclass

RC_CHANNELS, PERIOD_STEPS = 65, 5
"""The message, and how often it comes: 50 Hz."""
LOW_us, MIDDLE_us, HIGH_us = 1000, 1500, 2000
PARAMETERS: dict[str, int | float] = {
    "RC_CHAN_CNT": 5,
    "RC_MAP_ROLL": 1,
    "RC_MAP_PITCH": 2,
    "RC_MAP_THROTTLE": 3,
    "RC_MAP_YAW": 4,
    "RC_MAP_KILL_SW": 5,
}
"""What PX4 has to know of it. Whether PX4 heeds it is COM_RC_IN_MODE's choice."""
_CHANNELS, _UNUSED, _RSSI = 18, 65535, 254


@dataclass
class RadioControl:
    """What the pilot does with it. Sticks are -1..1, at rest in the middle: roll, pitch, throttle, yaw."""

    sticks: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    kill: bool = False
    on: bool = True

    def fields(self, time_us: int) -> tuple[int, ...]:
        """Of RC_CHANNELS, in the order of the wire."""
        sticks_us = (round(MIDDLE_us + (HIGH_us - MIDDLE_us) * stick) for stick in self.sticks)
        told = (*sticks_us, HIGH_us if self.kill else LOW_us)
        return (time_us // 1000, *told, *(_UNUSED,) * (_CHANNELS - len(told)), len(told), _RSSI)
