"""Texts of users and servers in pictures, shown literally."""

from __future__ import annotations


def as_written(text: str) -> str:
    """Escape a text so that matplotlib shows it literally, instead of reading formulas between dollar signs."""
    return text.replace("$", r"\$")
