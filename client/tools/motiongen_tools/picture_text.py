"""Texts in pictures: what users and servers wrote, as they wrote it."""

from __future__ import annotations


def as_written(text: str) -> str:
    """A text that matplotlib shows as it is: between two dollar signs it would read a formula, and fail at others."""
    return text.replace("$", r"\$")
