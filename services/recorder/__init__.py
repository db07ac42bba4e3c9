"""Recordings: written by service.py, read back by `Session`."""

from services.recorder.reading import Session

__all__ = ["Session"]
