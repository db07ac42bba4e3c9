"""A sensor that says exactly the same again has not looked: what is measured has noise, whatever its header says."""

from typing import Any

from schemas.message import Message

HEADER = set(Message.model_fields)


class Novelty:
    """Follows one topic: since when its content has not changed."""

    def __init__(self) -> None:
        self._content: dict[str, Any] = {}
        self._seq = 0
        self._since_ns = 0

    def age_s(self, message: Message, age_s: float) -> float:
        """Of the last new content; `age_s` is that of the message."""
        if message.seq != self._seq:
            self._seq = message.seq
            content = {name: value for name, value in message if name not in HEADER}
            if content != self._content:
                self._content, self._since_ns = content, message.stamp_ns
        return age_s + (message.stamp_ns - self._since_ns) * 1e-9
