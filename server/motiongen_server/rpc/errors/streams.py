"""Refusals that end a whole call: a reason for programs and a message for people."""

from __future__ import annotations

import asyncio
import logging
import secrets

import grpc
import grpc.aio

from motiongen_server.errors import StreamRefused

_log = logging.getLogger(__name__)

CLIENT_GONE = (grpc.aio.AioRpcError, grpc.aio.InternalError, grpc.aio.UsageError, asyncio.InvalidStateError)
"""What gRPC raises for a write to a client that has gone, before the call is seen to be cancelled."""


def hello_expected() -> StreamRefused:
    message = "the first message of a stream must carry hello"
    return StreamRefused(grpc.StatusCode.INVALID_ARGUMENT, "HELLO_EXPECTED", message, field="hello")


def hello_repeated() -> StreamRefused:
    return StreamRefused(grpc.StatusCode.INVALID_ARGUMENT, "HELLO_REPEATED", "hello was sent twice", field="hello")


def hello_late(within_s: float) -> StreamRefused:
    message = f"no hello came within {within_s:g} s; send it in the first message, when the stream begins"
    return StreamRefused(grpc.StatusCode.DEADLINE_EXCEEDED, "HELLO_LATE", message, field="hello")


def client_agent_too_long(num_characters: int, most: int) -> StreamRefused:
    message = f"client_agent has {num_characters} characters; at most {most} are allowed"
    return StreamRefused(grpc.StatusCode.INVALID_ARGUMENT, "CLIENT_AGENT_TOO_LONG", message, field="hello.client_agent")


def malformed(what: str) -> StreamRefused:
    message = f"a message could not be read ({what}); send messages of motiongen.v1"
    return StreamRefused(grpc.StatusCode.INVALID_ARGUMENT, "MALFORMED_REQUEST", message)


def request_of_too_many_fields(most: int) -> StreamRefused:
    """For a clip's request, whose fields were counted but which was not parsed."""
    message = f"the request has more than {most} fields; ask for fewer constraints and prompts"
    return StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "TOO_MANY_FIELDS", message, field="open")


def too_many_streams(most: int, kind: str = "") -> StreamRefused:
    """kind: that of the peer whose quota is used up; "": the server's own limit is."""
    whose = f"your {kind} has as many streams as it may (quota streams)" if kind else "there are no more streams left"
    message = f"{whose}, {most}; carry more sessions on each, or come back later"
    return StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "TOO_MANY_STREAMS", message, retry_after_s=5.0)


def stream_empty(after_s: float) -> StreamRefused:
    message = f"the stream has carried no session for {after_s:g} s; start another when there is a session to open"
    return StreamRefused(grpc.StatusCode.DEADLINE_EXCEEDED, "STREAM_EMPTY", message)


def reader_stuck(after_s: float) -> StreamRefused:
    message = f"the client has accepted no data for {after_s:g} s; read the stream as it comes"
    return StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "SLOW_READER", message)


def client_silent(after_s: float) -> StreamRefused:
    message = f"nothing came from the client for {after_s:g} s; send a ping every 10 s, and resume the sessions"
    return StreamRefused(grpc.StatusCode.UNAVAILABLE, "CLIENT_SILENT", message)


def no_memory_left(most: int) -> StreamRefused:
    held = f"the server holds more than {most} bytes that clients have not read, confirmed or paid for"
    message = f"{held}, and this client has the most of them; read what comes, or ask for less at a time"
    return StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "SLOW_READER", message)


def too_much_unpaid(most: int, kind: str) -> StreamRefused:
    """For messages held until their events are paid for, and requests whose clients have not closed their side."""
    message = f"unpaid messages of your {kind} take more than {most} bytes, and this call owes the most; send fewer"
    return StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "TOO_MUCH_UNPAID", message, retry_after_s=5.0)


def failed_inside(what: str, told: str, error: Exception) -> StreamRefused:
    """A fault of the server's own, logged under the error id that the client is given.

    what: what failed, for the log; told: the message for the client.
    """
    error_id = secrets.token_hex(4)
    _log.error("%s, error id %s", what, error_id, exc_info=error)
    return StreamRefused(grpc.StatusCode.INTERNAL, "INTERNAL", f"{told}, error id {error_id}")


def stream_failed(number: int, error: Exception) -> StreamRefused:
    return failed_inside(f"stream {number} failed", "the stream failed inside the server", error)
