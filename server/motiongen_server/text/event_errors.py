"""Refusals of prompts that cannot be encoded now. Each names the prompts that are still possible: those that need no
encoder.
"""

from __future__ import annotations

from motiongen_server.engine.types import Code
from motiongen_server.errors import EventRefused


def encoder_busy(most: int) -> EventRefused:
    """As many prompts as are allowed wait for the encoder."""
    message = f"{most} prompts wait for the text encoder already"
    return _refusal("TEXT_ENCODER_BUSY", message, 1.0, Code.RESOURCE_EXHAUSTED)


def too_many_texts(most_hz: float, kind: str, owed_s: float) -> EventRefused:
    """A tenant or an address sends more new texts to an encoder service than it may."""
    message = f"your {kind} asks for more than {most_hz:g} new texts a second (quota prompts_per_second)"
    return _refusal("TEXT_ENCODER_BUSY", message, max(0.1, owed_s), Code.RESOURCE_EXHAUSTED)


def encoder_slow(timeout_s: float) -> EventRefused:
    """The encoder did not answer in time."""
    message = f"the prompt has not been encoded within {timeout_s:g} s; it is still being encoded"
    return _refusal("TEXT_ENCODER_SLOW", message, timeout_s)


def encoder_away(error: ConnectionError) -> EventRefused:
    """The encoder cannot answer. error: the reason; its attribute `retry_after_s`, if any, says when to try again."""
    retry_after_s: float | None = getattr(error, "retry_after_s", None)
    return _refusal("TEXT_ENCODER_UNAVAILABLE", f"the prompt cannot be encoded: {error}", retry_after_s)


def _refusal(reason: str, message: str, retry_after_s: float | None, code: Code = Code.UNAVAILABLE) -> EventRefused:
    allowed = "prompts that were used before, presets, embeddings"
    return EventRefused(code, reason, message, allowed=allowed, retry_after_s=retry_after_s)
