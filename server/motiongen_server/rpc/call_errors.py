"""Why a call of one request is ended before it is answered, in words for programs and for people."""

from __future__ import annotations

import grpc

from motiongen_server.errors import StreamRefused

RETRY_AFTER_S = 1.0


def request_late(waited_s: float) -> StreamRefused:
    message = f"no whole request came within {waited_s:.3g} s; send it with the call, and end your side of it then"
    return StreamRefused(grpc.StatusCode.DEADLINE_EXCEEDED, "REQUEST_LATE", message)


def one_request_expected(num: str) -> StreamRefused:
    """num: how many came, in words."""
    message = f"{num} came; this method takes one request"
    return StreamRefused(grpc.StatusCode.UNIMPLEMENTED, "ONE_REQUEST_EXPECTED", message)


def too_many_checks(wait_s: float) -> StreamRefused:
    """Of signed tokens, of which too many did not hold."""
    message = f"too many tokens that came over your connection do not hold; show yours again in {wait_s:.1f} s"
    return StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "TOO_MANY_CALLS", message, retry_after_s=max(0.1, wait_s))


def too_many_calls_open(most: int, kind: str = "") -> StreamRefused:
    """kind: of the peer whose quota it is; "": the server's own limit."""
    whose = f"your {kind} has as many calls open as it may" if kind else "there are as many calls open as there may be"
    message = f"{whose}, {most}; read what earlier ones were answered, or come back later"
    return StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "TOO_MANY_CALLS", message, retry_after_s=RETRY_AFTER_S)


def request_too_long(num_bytes: int, most: int) -> StreamRefused:
    message = f"the request has {num_bytes} bytes; at most {most} are allowed here, send a shorter one"
    return StreamRefused(grpc.StatusCode.INVALID_ARGUMENT, "REQUEST_TOO_LONG", message)


def too_many_questions(wait_s: float) -> StreamRefused:
    """For reflection."""
    message = f"your address asks for more reflection than it may; ask again in {wait_s:.1f} s"
    return StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "TOO_MANY_CALLS", message, retry_after_s=max(0.1, wait_s))
