"""Why a prompt is not encoded now. All of them leave the same prompts: those that need no encoder."""

from __future__ import annotations

from motiongen_server.engine.types import Code
from motiongen_server.errors import EventRefused


def encoder_busy(most: int) -> EventRefused:
    """As many prompts wait for the encoder as may."""
    message = f"{most} prompts wait for the text encoder already"
    return _refusal("TEXT_ENCODER_BUSY", message, 1.0, Code.RESOURCE_EXHAUSTED)


def too_many_texts(most_hz: float, kind: str, owed_s: float) -> EventRefused:
    """A tenant, or an address, asks an encoder service for more new texts than it may."""
    message = f"your {kind} asks for more than {most_hz:g} new texts a second (quota prompts_per_second)"
    return _refusal("TEXT_ENCODER_BUSY", message, max(0.1, owed_s), Code.RESOURCE_EXHAUSTED)


def encoder_slow(timeout_s: float) -> EventRefused:
    """The encoder has not answered in time."""
    message = f"the prompt has not been encoded within {timeout_s:g} s; it still is being encoded"
    return _refusal("TEXT_ENCODER_SLOW", message, timeout_s)


def encoder_away(error: ConnectionError) -> EventRefused:
    """The encoder cannot answer. error: says why, and may say in `retry_after_s` when to ask again."""
    retry_after_s: float | None = getattr(error, "retry_after_s", None)
    return _refusal("TEXT_ENCODER_UNAVAILABLE", f"the prompt cannot be encoded: {error}", retry_after_s)


def _refusal(reason: str, message: str, retry_after_s: float | None, code: Code = Code.UNAVAILABLE) -> EventRefused:
    allowed = "prompts that were used before, presets, embeddings"
    return EventRefused(code, reason, message, allowed=allowed, retry_after_s=retry_after_s)
