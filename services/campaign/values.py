"""Lists of numbers as a person types them: `50,100,200`, or `2..20` for five values evenly spaced, `2..20:7` for seven."""

import re
from typing import NamedTuple

import numpy as np

from services.physics import Array

_RANGE = re.compile(r"([^.:]+(?:\.\d+)?)\.\.([^:]+?)(?::(\d+))?")
SPACED = 5


class Limits(NamedTuple):
    """Smallest and largest that a value may be."""

    low: float
    high: float


def values(option: str, text: str, limits: Limits) -> Array:
    """The numbers of `text`, rising, without repeats; ValueError names option, value and limit."""
    numbers = np.unique([x for part in text.split(",") for x in _part(option, part.strip())])
    for x in numbers:
        if not limits.low <= x <= limits.high:  # NaN is refused too
            raise ValueError(f"{option} = {text}: {x:g} must be between {limits.low:g} and {limits.high:g}")
    return numbers


def _part(option: str, text: str) -> Array:
    try:
        match = _RANGE.fullmatch(text)
        if match is None:
            return np.array([float(text)])
        return np.linspace(float(match[1]), float(match[2]), int(match[3] or SPACED))
    except ValueError:
        raise ValueError(f"{option} = {text!r}: numbers are needed, such as 50,100 or 2..20 or 2..20:7") from None
