"""The one error of files."""

from __future__ import annotations


class FormatError(ValueError):
    """Raised for a file that cannot be read, or motion that cannot be written, as the format asked for.

    source: the file, or what stands for it. given: what was found. allowed: what would do.
    """

    def __init__(self, source: object, given: str, allowed: str) -> None:
        super().__init__(f"{source}: {given}; {allowed}")
        self.source = str(source)
        self.given = given
        self.allowed = allowed


def shortened(value: object, limit: int = 60) -> str:
    """How a value from a file is quoted in a message: never long, whatever the file holds."""
    text = repr(value) if isinstance(value, (str, int, float, bool, type(None))) else type(value).__name__
    return text if len(text) <= limit else f"{text[: limit - 3]}..."
