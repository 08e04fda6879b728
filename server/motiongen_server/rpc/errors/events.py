"""Refusals of events and opens that only the edge gives; shared ones are in `engine.types.refusals`."""

from __future__ import annotations

from collections.abc import Iterable

from motiongen_server.engine.types import Code, Priority
from motiongen_server.errors import EventRefused

GATEWAY_RETRY_S = 2.0
STORE_RETRY_S = 1.0


def unknown_model(given: str, known: Iterable[str]) -> EventRefused:
    message = f"no model {given[:80]!r} is served"
    return EventRefused(Code.NOT_FOUND, "UNKNOWN_MODEL", message, "open.model_id", ", ".join(known))


def model_reloading(model_id: str) -> EventRefused:
    message = f"{model_id} is being reloaded"
    allowed = "the same model a little later, or another model of the catalogue"
    return EventRefused(Code.UNAVAILABLE, "MODEL_RELOADING", message, "open.model_id", allowed, retry_after_s=2.0)


def model_failed(model_id: str, why: str) -> EventRefused:
    """why: in words that are fit for clients, so without paths."""
    message, allowed = f"{model_id} is not served: {why}", "another model of the catalogue, or another server"
    return EventRefused(Code.UNAVAILABLE, "MODEL_FAILED", message, "open.model_id", allowed)


def too_many_sessions(held: int, limit: int) -> EventRefused:
    code, message = Code.RESOURCE_EXHAUSTED, f"the stream carries {held} sessions"
    return EventRefused(code, "TOO_MANY_SESSIONS", message, "open", f"at most {limit} on a stream; use another stream")


def gateway_overloaded(lag_s: float) -> EventRefused:
    """An open came while the event loop is overloaded."""
    message = f"messages wait {1000 * lag_s:.0f} ms to be read and written; try again later"
    allowed = "fewer streams with more sessions on each, fewer messages, or another server"
    return EventRefused(Code.RESOURCE_EXHAUSTED, "OVERLOADED", message, "open", allowed, GATEWAY_RETRY_S)


def sequence_gap(given: int, expected: int) -> EventRefused:
    message = f"event_seq is {given}, the next is {expected}"
    return EventRefused(Code.FAILED_PRECONDITION, "SEQUENCE_GAP", message, "event_seq", str(expected))


def invalid_event_seq(given: int) -> EventRefused:
    allowed = "0 for Playhead, else one more than the session's last event"
    return EventRefused(Code.INVALID_ARGUMENT, "INVALID_EVENT_SEQ", f"event_seq is {given}", "event_seq", allowed)


def handle_away(handle: int) -> EventRefused:
    """The session opened here on that handle closed as TAKEN_OVER, and another stream now carries it."""
    message = f"another stream has taken over the session that was opened on handle {handle}"
    allowed = "another handle, or this one once that stream has had the session's SessionClosed"
    return EventRefused(Code.ALREADY_EXISTS, "HANDLE_IN_USE", message, "session", allowed)


def session_not_kept() -> EventRefused:
    """No session with the resume token exists here."""
    allowed = "the token of a session that still exists; otherwise open a new session, with prior_frames"
    code, given = Code.NOT_FOUND, "no session with that token exists on this server any more"
    return EventRefused(code, "SESSION_NOT_KEPT", given, "open.resume_token", allowed)


def session_store_busy() -> EventRefused:
    """The resume needs the store of sessions, for which too many others already wait."""
    message, allowed = "too many clients are resuming sessions at the moment", "the same request a little later"
    code, field = Code.RESOURCE_EXHAUSTED, "open.resume_token"
    return EventRefused(code, "SESSION_STORE_BUSY", message, field, allowed, STORE_RETRY_S)


def session_store_unavailable() -> EventRefused:
    """The resume needs the store of sessions, which does not answer."""
    message, allowed = "the store of sessions does not answer", "the same request a little later, or another server"
    code, field = Code.UNAVAILABLE, "open.resume_token"
    return EventRefused(code, "SESSION_STORE_UNAVAILABLE", message, field, allowed, STORE_RETRY_S)


def events_not_saved(saved: int, answered: int) -> EventRefused:
    """The session's stored record lacks events that were already answered to its client."""
    message = f"events up to {saved} were saved, but the client has had answers up to {answered}"
    allowed = "a new session with prior_frames; tell it again everything that is in force"
    return EventRefused(Code.FAILED_PRECONDITION, "EVENTS_NOT_SAVED", message, "open.resume_token", allowed)


def resume_superseded(given: int, last: int) -> EventRefused:
    """The resume is not newer than the last one."""
    message, field = f"attempt {given} came after attempt {last}", "open.resume_point.attempt"
    return EventRefused(Code.FAILED_PRECONDITION, "RESUME_SUPERSEDED", message, field, f"a number above {last}")


def resume_out_of_range() -> EventRefused:
    """The resume point is one that no client can have reached."""
    message, field = "the session cannot be continued from there", "open.resume_point"
    allowed = "the first frame that you do not hold, and the last plan announced; or a new session, with prior_frames"
    return EventRefused(Code.FAILED_PRECONDITION, "RESUME_OUT_OF_RANGE", message, field, allowed)


def too_many_fields(most: int) -> EventRefused:
    """The event's fields were counted, but it was not parsed."""
    allowed = f"at most {most}, about 16 for each constraint and prompt that a session may have; send several events"
    message = "the event has too many fields"
    return EventRefused(Code.RESOURCE_EXHAUSTED, "TOO_MANY_FIELDS", message, "event", allowed)


def too_fast(rate: float, retry_after_s: float) -> EventRefused:
    code, message = Code.RESOURCE_EXHAUSTED, "the session sends events too fast"
    return EventRefused(code, "TOO_MANY_EVENTS", message, "event", f"{rate:g} a second", retry_after_s)


def peer_sessions(most: int, kind: str, field: str = "open") -> EventRefused:
    """For the sessions of all classes together."""
    message = f"your {kind} holds as many sessions as it may (quota session_weight)"
    allowed = f"sessions of one {kind} up to a weight of {most}, a HERO counting 4, a NEAR 2, others 1"
    return EventRefused(Code.RESOURCE_EXHAUSTED, "PEER_SESSION_LIMIT", message, field, allowed)


def peer_class(quota: str, most: int, priority: Priority, kind: str, field: str = "open.priority") -> EventRefused:
    """For the sessions of one class. quota: its name, as in `rpc.limits.PeerLimits`."""
    message = f"your {kind} holds {most} sessions of the class {priority.name}, its quota ({quota})"
    allowed = f"at most {most} of one {kind}; open it in another class"
    return EventRefused(Code.RESOURCE_EXHAUSTED, "PEER_SESSION_LIMIT", message, field, allowed)


def peer_steps(asked_hz: float, most_hz: float, kind: str, field: str) -> EventRefused:
    message = f"with this session, those of your {kind} would need {asked_hz:.3g} denoising steps a second to play on"
    allowed = f"up to {most_hz:.3g} a second of one {kind}; close a session, or ask for fewer steps"
    return EventRefused(Code.RESOURCE_EXHAUSTED, "STEPS_QUOTA", message, field, allowed)


def peer_waiting(most: int, kind: str) -> EventRefused:
    """For events that wait behind a prompt being encoded, or for a session being taken over."""
    message = f"your {kind} has {most} bytes of events waiting for prompts to be encoded, or for the store of sessions"
    allowed = "further events once earlier ones have been answered; presets, and prompts used before, need not wait"
    return EventRefused(Code.RESOURCE_EXHAUSTED, "TOO_MANY_PENDING_EVENTS", message, "event", allowed, 1.0)


def too_many_clips(most: int) -> EventRefused:
    code, message = Code.RESOURCE_EXHAUSTED, "other clips are being made; try again later"
    return EventRefused(code, "CLIP_LIMIT", message, "open", f"at most {most} calls for clips at once", 2.0)


def peer_clips(most: int, kind: str) -> EventRefused:
    message = f"your {kind} has as many clip samples under way as it may (quota clip_samples)"
    allowed = f"at most {most} samples at once of one {kind}"
    return EventRefused(Code.RESOURCE_EXHAUSTED, "PEER_CLIP_LIMIT", message, "sample_count", allowed, 1.0)


def internal(error_id: str) -> EventRefused:
    return EventRefused(Code.INTERNAL, "INTERNAL", f"the event failed inside the server, error id {error_id}")
