"""Why a stream refuses an event before the engine sees it, in words for programs and for people."""

from __future__ import annotations

from collections.abc import Iterable

from motiongen_server.engine.types import Code, Outcome, SessionKey
from motiongen_server.errors import EventRefused


def refusal_outcome(session: SessionKey, event_seq: int, refusal: EventRefused) -> Outcome:
    """The answer to an event that was refused."""
    return Outcome(
        session,
        event_seq,
        refusal.code,
        reason=refusal.reason,
        message=str(refusal),
        field=refusal.field,
        allowed=refusal.allowed,
        retry_after_s=refusal.retry_after_s,
    )


def unknown_model(given: str, known: Iterable[str]) -> EventRefused:
    return EventRefused(
        Code.NOT_FOUND,
        "UNKNOWN_MODEL",
        f"no model {given[:80]!r} is served",
        field="open.model_id",
        allowed=", ".join(known),
    )


def model_reloading(model_id: str) -> EventRefused:
    return EventRefused(
        Code.UNAVAILABLE,
        "MODEL_RELOADING",
        f"{model_id} is being loaded anew",
        field="open.model_id",
        allowed="the same a little later, or another model of the catalogue",
        retry_after_s=2.0,
    )


def model_failed(model_id: str) -> EventRefused:
    return EventRefused(
        Code.UNAVAILABLE,
        "MODEL_FAILED",
        f"the engine of {model_id} has failed",
        field="open.model_id",
        allowed="another model of the catalogue, or another server",
    )


def not_open(handle: int) -> EventRefused:
    return EventRefused(
        Code.NOT_FOUND,
        "SESSION_NOT_OPEN",
        f"no session is open on handle {handle}",
        field="session",
        allowed="the handle of an open session; send OpenSession first",
    )


def handle_in_use(handle: int) -> EventRefused:
    return EventRefused(
        Code.ALREADY_EXISTS,
        "HANDLE_IN_USE",
        f"handle {handle} carries an open session",
        field="session",
        allowed="a handle that is not in use, or this one after its SessionClosed",
    )


def draining() -> EventRefused:
    return EventRefused(
        Code.UNAVAILABLE,
        "DRAINING",
        "the server is shutting down and opens no more sessions",
        field="open",
        allowed="open on another server, or here after a restart",
    )


def too_many_sessions(held: int, limit: int) -> EventRefused:
    return EventRefused(
        Code.RESOURCE_EXHAUSTED,
        "TOO_MANY_SESSIONS",
        f"the stream carries {held} sessions",
        field="open",
        allowed=f"at most {limit} on a stream; use another stream",
    )


def sequence_gap(given: int, expected: int) -> EventRefused:
    return EventRefused(
        Code.FAILED_PRECONDITION,
        "SEQUENCE_GAP",
        f"event_seq is {given}, the next is {expected}",
        field="event_seq",
        allowed=str(expected),
    )


def invalid_event_seq(given: int) -> EventRefused:
    return EventRefused(
        Code.INVALID_ARGUMENT,
        "INVALID_EVENT_SEQ",
        f"event_seq is {given}",
        field="event_seq",
        allowed="0 for Playhead, else one more than the session's last event",
    )


def too_fast(rate: float, retry_after_s: float) -> EventRefused:
    return EventRefused(
        Code.RESOURCE_EXHAUSTED,
        "TOO_MANY_EVENTS",
        "the session sends events too fast",
        field="event",
        allowed=f"{rate:g} a second",
        retry_after_s=retry_after_s,
    )


def too_much_waits(num_events: int, most: int) -> EventRefused:
    """Events that wait for a prompt to be encoded."""
    return EventRefused(
        Code.RESOURCE_EXHAUSTED,
        "TOO_MANY_PENDING_EVENTS",
        f"{num_events} events of the session wait for a prompt to be encoded",
        allowed=f"at most {most} events waiting for a session; send again when one has been answered",
    )


def peer_sessions(most: int) -> EventRefused:
    return EventRefused(
        Code.RESOURCE_EXHAUSTED,
        "PEER_SESSION_LIMIT",
        "your address holds as many sessions as one may",
        field="open",
        allowed=f"sessions of one address up to a weight of {most}, a HERO counting 4, a NEAR 2, others 1",
    )


def peer_heroes(most: int) -> EventRefused:
    return EventRefused(
        Code.RESOURCE_EXHAUSTED,
        "PEER_SESSION_LIMIT",
        f"your address holds {most} sessions of the class HERO",
        field="open.priority",
        allowed=f"at most {most} of one address; open it as NEAR",
    )


def too_many_clips(most: int) -> EventRefused:
    return EventRefused(
        Code.RESOURCE_EXHAUSTED,
        "CLIP_LIMIT",
        "other clips are being made; try again later",
        allowed=f"at most {most} calls for clips at once",
        retry_after_s=2.0,
    )


def peer_clips(most: int) -> EventRefused:
    return EventRefused(
        Code.RESOURCE_EXHAUSTED,
        "PEER_CLIP_LIMIT",
        "your address has as many samples of clips made as one may",
        field="sample_count",
        allowed=f"at most {most} samples at once of one address",
        retry_after_s=1.0,
    )


def closed_before() -> EventRefused:
    """The event found its session closing."""
    return EventRefused(
        Code.CANCELLED,
        "SESSION_CLOSED",
        "the session closed before the event took effect",
        field="session",
        allowed="open a new session after SessionClosed",
    )


def internal(error_id: str) -> EventRefused:
    return EventRefused(Code.INTERNAL, "INTERNAL", f"the event failed inside the server, error id {error_id}")
