"""The errors of this package: one class for each that a caller can act on.

Every message says what was given, what is allowed and what to do. All derive from `MotiongenError`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


class MotiongenError(Exception):
    """Base class of every error that this package raises on purpose."""


class InvalidInput(MotiongenError, ValueError):
    """An argument that cannot be sent. Raised before anything goes to the server.

    field: the argument; given: its value; allowed: what would have been accepted.
    """

    def __init__(self, field: str, given: object, allowed: str) -> None:
        super().__init__(f"{field}: {given!r} was given; allowed is {allowed}")
        self.field = field
        self.given = given
        self.allowed = allowed


class UnknownName(MotiongenError, LookupError):
    """A joint, rig or model that does not exist. `known` lists the names that would have worked."""

    def __init__(self, kind: str, given: str, known: Sequence[str]) -> None:
        super().__init__(f"no {kind} is called {given!r}; known are: {', '.join(known) or '(none)'}")
        self.kind = kind
        self.given = given
        self.known = tuple(known)


class ServerUnavailable(MotiongenError, ConnectionError):
    """No server answered at `address`. Check the address and whether the server is ready, then connect again."""

    def __init__(self, address: str, detail: str) -> None:
        super().__init__(
            f"no motiongen server answers at {address}: {detail}. Is it running and ready (/readyz), and are both with "
            "TLS, or both without it?"
        )
        self.address = address
        self.detail = detail


class NotAllowed(MotiongenError, PermissionError):
    """The server at `address` does not admit this caller, or not to this call. Use another token or certificate.

    reason: stable name of the mistake, listed in docs/protocol.md; "" if the server gave none.
    """

    def __init__(self, address: str, event: str, reason: str, message: str) -> None:
        super().__init__(f"{event} is not allowed at {address} ({reason or 'no reason given'}): {message}")
        self.address = address
        self.reason = reason


class StreamLost(MotiongenError, ConnectionError):
    """The stream ended for good, and its sessions with it. Open a new stream and new sessions.

    A stream recovers from losses by itself (`LinePolicy`). This is raised if a new call would end in the same way, if
    the time for recovery is over, or if the first call of a stream is cut before the server has answered its hello.

    code: name of the gRPC status, for example "UNAVAILABLE"; detail: the status text; reason: stable name of the cause,
    if the server gave one.
    """

    def __init__(self, code: str, detail: str, reason: str = "") -> None:
        super().__init__(f"the stream to the server was lost ({code}: {detail or 'no detail'}); open a new one")
        self.code = code
        self.detail = detail
        self.reason = reason


class SessionEnded(MotiongenError):
    """The session is over.

    reason: client, idle, slow_reader, drained, engine_fault, overload or model_unloaded.
    """

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(f"the session has ended ({reason}): {message or 'no further detail'}; open a new one")
        self.reason = reason
        self.message = message


@dataclass(frozen=True)
class OtherServer:
    """A server with free capacity, named by one that has none.

    address: host:port, or "" if not stated. routing_key: value of the metadata x-motiongen-key with which a proxy at
    the same address routes calls to that server; "" if none is known.
    """

    address: str = ""
    routing_key: str = ""


class EventRefused(MotiongenError):
    """The server refused an event. The event changed nothing, and the session continues.

    event: what was tried; code: name of the google.rpc code; reason: stable name of the mistake, listed in
    docs/protocol.md, or OUTBOX_FULL if this client refused the event because too many bytes wait to be sent or
    answered; field: path of the field at fault; allowed: what would have been accepted there; retry_after_s: how long
    to wait before trying the same again, None if waiting is not known to help; other_servers: servers with free
    capacity for the refused session, best first. `MotionClient.open` has already tried those that it may.
    """

    def __init__(
        self,
        event: str,
        code: str,
        reason: str,
        message: str,
        *,
        field: str = "",
        allowed: str = "",
        retry_after_s: float | None = None,
        other_servers: Sequence[OtherServer] = (),
    ) -> None:
        where = f" at {field}" if field else ""
        hint = f"; allowed is {allowed}" if allowed else ""
        hint += f"; try again in {retry_after_s:g} s" if retry_after_s is not None else ""
        super().__init__(f"{event} was refused with {reason or code}{where}: {message}{hint}")
        self.event = event
        self.code = code
        self.reason = reason
        self.message = message
        self.field = field
        self.allowed = allowed
        self.retry_after_s = retry_after_s
        self.other_servers = tuple(other_servers)


class DeadlineExceeded(MotiongenError, TimeoutError):
    """A clip was not finished in time and is abandoned. Ask for less, or allow more time."""

    def __init__(self, what: str, timeout_s: float | None) -> None:
        within = f" within {timeout_s:g} s" if timeout_s is not None else " within the time the server allows"
        super().__init__(f"{what} was not finished{within}; ask for fewer frames or samples, or allow more time")
        self.timeout_s = timeout_s


class ProtocolViolation(MotiongenError):
    """The server broke a rule of the protocol. It is not the caller's mistake: report it with the server's version."""


class MissingExtra(MotiongenError, ImportError):
    """A feature of the tools needs a package that is not installed.

    extra: the extra of motiongen-tools that installs it; "" if none does.
    """

    def __init__(self, feature: str, package: str, extra: str) -> None:
        wanted = f"'motiongen-tools[{extra}]'" if extra else package
        super().__init__(f"{feature} needs {package}: install it with `pip install {wanted}`")
        self.feature = feature
        self.package = package
        self.extra = extra
