"""EventRefused: why an event is refused, in any room; and the refusals that several rooms give."""

from __future__ import annotations

from motiongen_server.engine.types.names import Code, SessionKey
from motiongen_server.engine.types.outputs import Outcome


class EventRefused(Exception):
    """An event is answered with an outcome and has changed nothing; its stream and other sessions continue.

    reason: an UPPER_SNAKE word that a program can act on; field: the path of the field at fault; allowed: what it may
    contain; retry_after_s: when the same event would be accepted, None if waiting does not help.
    """

    def __init__(
        self,
        code: Code,
        reason: str,
        message: str,
        field: str = "",
        allowed: str = "",
        retry_after_s: float | None = None,
    ) -> None:
        super().__init__(message)
        self.code = code
        self.reason = reason
        self.field = field
        self.allowed = allowed
        self.retry_after_s = retry_after_s

    def outcome(self, session: SessionKey, event_seq: int) -> Outcome:
        """The answer to the event with this number."""
        said = self.reason, str(self), self.field, self.allowed, self.retry_after_s
        return Outcome(session, event_seq, self.code, None, *said)


def session_not_open(handle: int) -> EventRefused:
    """No session has the event's handle."""
    given = f"no session is open on handle {handle}"
    allowed = "the handle of an open session; send OpenSession first"
    return EventRefused(Code.NOT_FOUND, "SESSION_NOT_OPEN", given, "session", allowed)


def handle_in_use(handle: int) -> EventRefused:
    """The handle of an Open belongs to an open session."""
    given = f"handle {handle} carries an open session"
    allowed = "a handle that is not in use, or this one after its SessionClosed"
    return EventRefused(Code.ALREADY_EXISTS, "HANDLE_IN_USE", given, "session", allowed)


def prior_frames_failed(field: str) -> EventRefused:
    """The model cannot read the frames that a session is to continue from."""
    given, allowed = "the model cannot read the prior frames", "other frames, or none"
    return EventRefused(Code.INTERNAL, "PRIOR_FRAMES_FAILED", given, field, allowed)


def session_closed() -> EventRefused:
    """The session closed before the event took effect."""
    given = "the session closed before the event took effect"
    return EventRefused(Code.CANCELLED, "SESSION_CLOSED", given, "session", "a new session, opened after SessionClosed")


def draining() -> EventRefused:
    """The server shuts down and takes no more sessions."""
    given = "the server is shutting down and opens no more sessions"
    allowed = "a session on another server, or here after a restart"
    return EventRefused(Code.UNAVAILABLE, "DRAINING", given, "open", allowed)


def engine_restarting(retry_after_s: float) -> EventRefused:
    """An event came while there is no engine process."""
    given = "the server's engine is being started anew; open a session again in a moment"
    return EventRefused(Code.UNAVAILABLE, "ENGINE_RESTARTING", given, retry_after_s=retry_after_s)


def session_limit(most: int, retry_after_s: float) -> EventRefused:
    """As many sessions are open as allowed."""
    allowed = f"at most {most} sessions at once"
    code, given = Code.RESOURCE_EXHAUSTED, "the server is full; try again later"
    return EventRefused(code, "SESSION_LIMIT", given, "open", allowed, retry_after_s)


def too_many_pending(what: str, most: int) -> EventRefused:
    """As many events of the session wait as allowed. what: their kind, such as "edits"."""
    given = f"{most} {what} of this session wait already; send again when one has been answered"
    return EventRefused(
        Code.RESOURCE_EXHAUSTED, "TOO_MANY_PENDING_EVENTS", given, allowed=f"at most {most} {what} that wait"
    )
