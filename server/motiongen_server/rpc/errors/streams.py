"""Why a whole call is ended, in words for programs and for people."""

from __future__ import annotations

import asyncio
import logging
import secrets

import grpc
import grpc.aio

from motiongen_server.errors import StreamRefused

_log = logging.getLogger(__name__)

CLIENT_GONE = (grpc.aio.AioRpcError, grpc.aio.InternalError, grpc.aio.UsageError, asyncio.InvalidStateError)
"""What gRPC raises for a write to a client that has gone, whose cancellation has not been seen yet."""


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
    """Of the request for a clip, which was counted and not read."""
    message = f"the request has more than {most} fields; ask for fewer constraints and prompts"
    return StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "TOO_MANY_FIELDS", message, field="open")


def too_many_streams(most: int, kind: str = "") -> StreamRefused:
    """kind: of the peer whose quota it is; "": the server's own limit."""
    whose = f"your {kind} has as many streams as it may (quota streams)" if kind else "there are no more streams left"
    message = f"{whose}, {most}; carry more sessions on each, or come back later"
    return StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "TOO_MANY_STREAMS", message, retry_after_s=5.0)


def stream_empty(after_s: float) -> StreamRefused:
    message = f"the stream has carried no session for {after_s:g} s; begin another when there is one to open"
    return StreamRefused(grpc.StatusCode.DEADLINE_EXCEEDED, "STREAM_EMPTY", message)


def reader_stuck(after_s: float) -> StreamRefused:
    message = f"the client has taken nothing of what was written for {after_s:g} s; read the stream as it comes"
    return StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "SLOW_READER", message)


def client_silent(after_s: float) -> StreamRefused:
    message = f"nothing came from the client for {after_s:g} s; send a ping every 10 s, and resume the sessions"
    return StreamRefused(grpc.StatusCode.UNAVAILABLE, "CLIENT_SILENT", message)


def no_memory_left(most: int) -> StreamRefused:
    held = f"more than {most} bytes are held of what clients have not read, confirmed or paid for"
    message = f"{held}, and most are this one's; read what comes, or ask for less at a time"
    return StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "SLOW_READER", message)


def too_much_unpaid(most: int, kind: str) -> StreamRefused:
    """Of messages that were read, and whose events the stream owes for, or of requests that are not ended."""
    message = f"messages of your {kind} that are not paid for take {most} bytes, and this one owes most; send fewer"
    return StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "TOO_MUCH_UNPAID", message, retry_after_s=5.0)


def failed_inside(what: str, told: str, error: Exception) -> StreamRefused:
    """Of a fault of the server's own, which is logged beside the number that the client is told.

    what: failed, for the log; told: what the client is told of it.
    """
    error_id = secrets.token_hex(4)
    _log.error("%s, error id %s", what, error_id, exc_info=error)
    return StreamRefused(grpc.StatusCode.INTERNAL, "INTERNAL", f"{told}, error id {error_id}")


def stream_failed(number: int, error: Exception) -> StreamRefused:
    return failed_inside(f"stream {number} failed", "the stream failed inside the server", error)
