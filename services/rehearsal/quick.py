"""The demo in a hurry: the same system and laws, shorter waits and a 1.5 m path, for tests that break something on the way."""

from dataclasses import replace
from typing import Any

from services.config import Config, load

SHORT_PATH: dict[str, Any] = {
    "name": "short",
    "waypoints_m": [[-2.0, -0.5], [-1.25, -0.45], [-0.5, -0.5]],
    "force": {"f_start_N": 1.0, "f_max_N": 1.5, "ramp_up_fraction": 0.1, "ramp_down_fraction": 0.3},
}


def quick_config(person: str = "default") -> Config:
    """Guiding begins about 10 s after the start instead of 18."""
    return quicker(load("demo", person=person))


def quicker(config: Config) -> Config:
    """The same changes to any profile."""
    supervisor, estimator = config.safety_supervisor, config.force_estimator
    times = replace(supervisor.times, settle_s=0.5, held_s=1.0, fast_mps=1.2, step_back_s=0.5)
    bias = replace(estimator.bias, tare_s=2.0, tare_std_max_N=0.6)
    hand = replace(config.person.subject, reach_speed_mps=1.0)
    return config.model_copy(
        update={
            "path": SHORT_PATH,
            "safety_supervisor": replace(supervisor, times=times),
            "force_estimator": replace(estimator, bias=bias),
            "person": replace(config.person, subject=hand),
            "simulator": replace(config.simulator, clear_of_start_m=0.9),
        }
    )
