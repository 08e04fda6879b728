"""What the engine says to events that it cannot take, in words for programs and for people."""

from __future__ import annotations

from motiongen_server.engine.types import Code, Event, Open, Outcome


def handle_in_use(event: Open) -> Outcome:
    message = "a session with this handle is open on this stream; choose another handle"
    allowed = "a handle that is not in use"
    return _refusal(event, Code.ALREADY_EXISTS, "HANDLE_IN_USE", message, "session", allowed)


def prior_frames_failed(event: Open) -> Outcome:
    message = "the model can make nothing of the prior frames"
    return _refusal(event, Code.INTERNAL, "PRIOR_FRAMES_FAILED", message, "open.prior_frames", "other frames, or none")


def not_open(event: Event) -> Outcome:
    message = "no session with this handle is open on this stream; open one first"
    return _refusal(event, Code.NOT_FOUND, "SESSION_NOT_OPEN", message, "session")


def _refusal(event: Event, code: Code, reason: str, message: str, field: str, allowed: str = "") -> Outcome:
    return Outcome(event.session, event.event_seq, code, None, reason, message, field, allowed)
