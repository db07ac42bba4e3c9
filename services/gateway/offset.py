"""How far two clocks are apart, from questions and answers, as NTP does it. Pure.

| symbol | here | unit |
|---|---|---|
| sent, received, on the asker's clock | t_0, t_3 | ns |
| answered, on the other's clock | t_1 | ns |
| offset: the other's clock less the asker's | theta_ns | ns |
| round trip | t_3 - t_0 | ns |

Whatever the way there and the way back took, the offset lies within half the round trip of `t_1 - (t_0 + t_3) / 2`. The
best of the last answers is kept: the one whose bound, widened by the clocks' drift since then, is the tightest.
"""

from typing import NamedTuple

KEEP = 60
"""Answers that are remembered."""


class Answer(NamedTuple):
    """One question and its answer."""

    t_0_ns: int
    t_1_ns: int
    t_3_ns: int

    @property
    def theta_ns(self) -> int:
        """The offset, if both ways took the same time."""
        return self.t_1_ns - (self.t_0_ns + self.t_3_ns) // 2

    def bound_ns(self, now_ns: int, drift_per_s: float) -> float:
        """How far off `theta_ns` can be at `now_ns`."""
        return (self.t_3_ns - self.t_0_ns) / 2 + drift_per_s * (now_ns - self.t_3_ns)


class Estimate(NamedTuple):
    """The offset and how far off it can be."""

    theta_ns: int
    uncertainty_ns: float


def step(answers: tuple[Answer, ...], new: Answer) -> tuple[Answer, ...]:
    """Remember one more; one that cannot have happened (sent after it was received) is not."""
    return (*answers, new)[-KEEP:] if new.t_3_ns >= new.t_0_ns else answers


def estimate(answers: tuple[Answer, ...], now_ns: int, drift_per_s: float) -> Estimate | None:
    """The tightest of what is remembered; None before the first answer."""
    if not answers:
        return None
    best = min(answers, key=lambda answer: answer.bound_ns(now_ns, drift_per_s))
    return Estimate(best.theta_ns, best.bound_ns(now_ns, drift_per_s))
