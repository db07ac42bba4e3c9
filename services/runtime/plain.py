"""Errors that need no traceback."""


class PlainError(RuntimeError):
    """Its text says what is wrong and what to do: a service that ends by it says one line."""
