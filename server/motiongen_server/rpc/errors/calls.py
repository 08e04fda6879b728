"""Refusals of calls that take one request: a reason for programs and a message for people."""

from __future__ import annotations

import grpc

from motiongen_server.errors import StreamRefused


def request_late(waited_s: float) -> StreamRefused:
    message = f"no complete request arrived within {waited_s:.3g} s; send it with the call, then close your side"
    return StreamRefused(grpc.StatusCode.DEADLINE_EXCEEDED, "REQUEST_LATE", message)


def one_request_expected(num: str) -> StreamRefused:
    """num: how many requests came, in words."""
    message = f"{num} came; this method takes one request"
    return StreamRefused(grpc.StatusCode.UNIMPLEMENTED, "ONE_REQUEST_EXPECTED", message)


def request_too_long(num_bytes: int, most: int) -> StreamRefused:
    message = f"the request has {num_bytes} bytes; at most {most} are allowed here, send a shorter one"
    return StreamRefused(grpc.StatusCode.INVALID_ARGUMENT, "REQUEST_TOO_LONG", message)


def headers_too_long(num_bytes: int, most: int) -> StreamRefused:
    message = f"the call's headers have {num_bytes} bytes, {most} are allowed; heed the server's HTTP/2 settings"
    return StreamRefused(grpc.StatusCode.INVALID_ARGUMENT, "HEADERS_TOO_LONG", message)
