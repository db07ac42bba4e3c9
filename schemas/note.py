"""What a person wants to be read with the recording."""

from schemas.message import Message


class OperatorNote(Message):
    """A remark, at the time it was made."""

    operator: str
    text: str

    @property
    def voice(self) -> str:
        """Each person's console counts for itself."""
        return self.operator
