"""The error that all formats raise."""

from __future__ import annotations


class FormatError(ValueError):
    """Raised for a file that cannot be read, or a motion that cannot be written, in the requested format.

    source: the file, or a name for the input. given: what was found. allowed: what is accepted.
    """

    def __init__(self, source: object, given: str, allowed: str) -> None:
        super().__init__(f"{source}: {given}; {allowed}")
        self.source = str(source)
        self.given = given
        self.allowed = allowed


def shortened(value: object, limit: int = 60) -> str:
    """A value from a file as quoted in messages: short, whatever the file holds."""
    text = repr(value) if isinstance(value, (str, int, float, bool, type(None))) else type(value).__name__
    return text if len(text) <= limit else f"{text[: limit - 3]}..."
