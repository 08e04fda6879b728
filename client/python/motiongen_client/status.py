"""Turns the status of a failed call into an error that a caller can act on."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import TypeVar

import grpc
import grpc.aio
from google.rpc import error_details_pb2, status_pb2  # type: ignore[import-untyped]

from motiongen_client.errors import EventRefused, MotiongenError, NotAllowed, ServerUnavailable, StreamLost

T = TypeVar("T")

NOT_ALLOWED = (grpc.StatusCode.UNAUTHENTICATED, grpc.StatusCode.PERMISSION_DENIED)
CREDENTIALS_EXPIRED = "CREDENTIALS_EXPIRED"
STARTING = "STARTING"
"""The reason of a server that runs but cannot serve yet; it no longer has any earlier sessions."""
STATUS_LOST = "Internal error from Core"
"""Details that grpc.aio gives for a call that ended while something was being written to it. The status that the server
sent cannot be obtained then."""
MOST_TIMEOUT_S = 1e9
"""Limit on the timeout of a call: gRPC ends calls with much longer ones at once, as if the time were over."""
_DETAILS = "grpc-status-details-bin"


async def answer_of(call: Awaitable[T]) -> T:
    """What a call returns. Raises StreamLost if its channel is closed meanwhile.

    grpc.aio reports that as a CancelledError, which would silently end the waiting task.
    """
    try:
        return await call
    except asyncio.CancelledError:
        task = asyncio.current_task()
        if task is None or task.cancelling():
            raise
        raise StreamLost("CANCELLED", "the client was closed") from None


def error_of(failure: grpc.aio.AioRpcError, event: str, address: str) -> MotiongenError:
    """EventRefused with the server's details, NotAllowed, or ServerUnavailable if no server answered.

    event: what was tried, in words.
    """
    code, message = failure.code(), failure.details() or ""
    info, bad, retry = error_details_pb2.ErrorInfo(), error_details_pb2.BadRequest(), error_details_pb2.RetryInfo()
    retry_after_s = None
    for name, value in failure.trailing_metadata() or ():
        if name != _DETAILS or not isinstance(value, bytes):
            continue
        status = status_pb2.Status.FromString(value)
        message = status.message
        for detail in status.details:
            if detail.Unpack(retry):
                retry_after_s = retry.retry_delay.seconds + retry.retry_delay.nanos / 1e9
            elif not detail.Unpack(info):
                detail.Unpack(bad)
    if code is grpc.StatusCode.UNAVAILABLE and not info.reason:
        return ServerUnavailable(address, message or code.name)
    if code in NOT_ALLOWED:
        return NotAllowed(address, event, info.reason, message)
    field = bad.field_violations[0].field if bad.field_violations else ""
    allowed = info.metadata.get("allowed", "")
    said = message.removesuffix(f"; allowed is {allowed}") if allowed else message
    return EventRefused(event, code.name, info.reason, said, field=field, allowed=allowed, retry_after_s=retry_after_s)


def reason_of(failure: grpc.aio.AioRpcError) -> str:
    """The stable name that the server gave for the cause; "" if it gave none."""
    refusal = error_of(failure, "", "")
    return refusal.reason if isinstance(refusal, EventRefused | NotAllowed) else ""
