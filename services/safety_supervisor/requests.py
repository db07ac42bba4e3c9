"""Each request is acted upon once, however often its sender repeats it; the answer is repeated instead.

Else the late copy of a `resume` could take back what a second person has asked for meanwhile. Of several that wait, the one
that asks for most comes first; the others come again.
"""

from collections.abc import Sequence

from schemas.safety import Action, OperatorReply, OperatorRequest

ORDER = (Action.KILL, Action.LAND, Action.HOLD, Action.EASE, Action.RESUME, Action.START)
REMEMBERED = 64


class Requests:
    """What has been asked for and answered."""

    def __init__(self) -> None:
        self._answers: dict[int, OperatorReply] = {}
        self._due: list[OperatorReply] = []

    def next(self, arrived: Sequence[OperatorRequest]) -> OperatorRequest | None:
        """The one to act upon now."""
        self._due = [self._answers[r.request_id] for r in arrived if r.request_id in self._answers]
        new = [r for r in arrived if r.request_id not in self._answers]
        return min(new, key=lambda r: ORDER.index(r.action), default=None)

    def answered(self, reply: OperatorReply) -> None:
        """Remember the answer and give it. A refusal is not remembered: asking again may help."""
        self._due.append(reply)
        if reply.accepted:
            self._answers[reply.request_id] = reply
            if len(self._answers) > REMEMBERED:
                self._answers.pop(next(iter(self._answers)))

    def replies(self) -> list[OperatorReply]:
        """All answers that are due."""
        due, self._due = self._due, []
        return due
