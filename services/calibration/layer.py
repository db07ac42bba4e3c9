"""A calibration laid over a profile: the profile names its file (`system.calibration`), its values go over what stands there.

They were measured. A profile that is to study a wrong belief names no calibration.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from pydantic import TypeAdapter

from services.calibration.result import Calibration
from services.profile_file import ConfigError, deploy_folder, find, get, layered, put

_TARGETS = {  # where a value goes in the profile
    "thrust": {
        name: (f"px4_bridge.vehicle.{name}",)
        for name in ("max_thrust_N", "thrust_curve", "thrust_error", "voltage_exponent", "reference_V", "rpm_max")
    },
    "mass": {"m_R_kg": ("px4_bridge.flight.m_R_kg", "px4_bridge.admittance.M_A_kg", "force_estimator.observer.m_R_kg")},
    "handle": {"offset_m": ("tracker.mocap.handle.offset_m",)},
    "delay": {"delay_s": ("px4_bridge.px4.EKF2_EV_DELAY",)},
}
_FACTORS = {"delay_s": 1000.0}  # PX4 has it in milliseconds


def targets(calibration: Mapping[str, Any]) -> dict[str, Any]:
    """Dotted keys of a profile with the values that the file's tables give them; what is malformed is left to the validation."""
    found: dict[str, Any] = {}
    for kind, names in _TARGETS.items():
        table = calibration.get(kind)
        for name, keys in names.items():
            value = cast("dict[str, Any]", table).get(name) if isinstance(table, dict) else None
            if isinstance(value, (int, float)):
                value = value * _FACTORS.get(name, 1.0)
            found |= {key: value for key in keys if value is not None}
    return found


def lay_over(data: dict[str, Any], file: Path) -> dict[str, Path]:
    """Put what `data["calibration"]`, read from `file`, says over the profile; returns where each value now stands.

    Raises pydantic.ValidationError, and ConfigError where its thrust is by another source than the profile's.
    """
    TypeAdapter(Calibration).validate_python(data["calibration"])
    told, chosen = get(data, "calibration.thrust.thrust_source"), get(data, "px4_bridge.vehicle.thrust_source")
    if told not in (None, chosen):
        raise ConfigError(f"{file}: thrust.thrust_source = {told}: must be the profile's, px4_bridge.vehicle: {chosen}")
    found = {key: value for key, value in targets(data["calibration"]).items() if _applies(data, key)}
    for key, value in found.items():
        put(data, key, value, over=True)
    return dict.fromkeys(found, file)


def _applies(data: dict[str, Any], key: str) -> bool:
    """Markers are a real capture system's alone."""
    return not key.startswith("tracker.mocap.") or get(data, "tracker.mocap") is not None


def calibration_file(profile: str) -> Path | None:
    """Where the calibration of a profile is, or will be; None where the profile names none. Raises ConfigError."""
    data, _ = layered(find("profiles", profile))
    name = get(data, "system.calibration")
    if not name:
        return None
    return Path(name) if str(name).endswith(".toml") else deploy_folder() / "calibration" / f"{name}.toml"
