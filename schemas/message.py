"""The header every message carries, and the small types that messages are made of.

Rules: SI units, unit in the field's name, frame as suffix where it is not the world (`_B`); no NaN, no infinity, no
optional field, no union and no tuple, so that any log viewer can read the recorded JSON. What cannot be trusted says
`valid = false` and why.
"""

from collections.abc import Sequence
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field


class Part(BaseModel):
    """A piece of a message: immutable, closed, finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Vec3(Part):
    """Three components, in the unit that the field's name says."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0

    @classmethod
    def of(cls, v: Sequence[float] | NDArray[np.float64]) -> Self:
        """From an array or sequence of shape (3,)."""
        x, y, z = map(float, v)
        return cls(x=x, y=y, z=z)

    def array(self) -> NDArray[np.float64]:
        """As an array of shape (3,)."""
        return np.array((self.x, self.y, self.z))


class Quaternion(Part):
    """Unit, Hamilton. A field `q_WB_wxyz` takes vectors from B to W."""

    w: float = 1.0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0

    @classmethod
    def of(cls, q_wxyz: Sequence[float] | NDArray[np.float64]) -> Self:
        """From an array or sequence of shape (4,), w first."""
        w, x, y, z = map(float, q_wxyz)
        return cls(w=w, x=x, y=y, z=z)

    def array(self) -> NDArray[np.float64]:
        """As an array of shape (4,), w first."""
        return np.array((self.w, self.x, self.y, self.z))


TICK, MISSED = "tick", "tick.missed"
"""Names in `inputs` beside the topics: which turn of the publisher's loop (from 1), and periods it came too late for."""


class Message(Part):
    """Provenance and validity of everything on the bus.

    `seq` counts the publisher's messages of this topic from 1. `stamp_ns` is when the content was true at its source, on
    the monotonic clock of the publisher's host; `said_ns` is that clock in the turn that published it, by which the age
    of what it was computed from was judged. `inputs` names the seq of each message this one was computed from, by
    topic; a topic that is absent was not used (or nothing of it had arrived). Of a topic whose every message counts, it
    names the last. Together they are all that a service's next message depends on.
    """

    seq: int = Field(default=0, ge=0)
    stamp_ns: int = Field(default=0, ge=0)
    said_ns: int = Field(default=0, ge=0)
    inputs: dict[str, int] = Field(default_factory=dict)
    valid: bool = True
    invalid_reason: str = ""

    @property
    def voice(self) -> str:
        """Whose count `seq` is, on a topic on which more than one may speak."""
        return ""
