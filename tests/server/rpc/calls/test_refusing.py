"""Refusals of calls whose client has just gone."""

from __future__ import annotations

import asyncio
from typing import Any

import grpc
import grpc.aio
import pytest

from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.calls.context import refuse

REFUSAL = StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "SLOW_READER", "read the stream as it comes")


class Context:
    """The context of a call whose abort raises the given error."""

    def __init__(self, error: Exception) -> None:
        self.told: list[grpc.StatusCode] = []
        self._error = error

    async def abort(self, code: grpc.StatusCode, details: str, trailing_metadata: Any) -> None:
        self.told.append(code)
        raise self._error


async def test_refusal_to_a_client_that_has_gone_ends_as_a_cancelled_call() -> None:
    context = Context(grpc.aio.InternalError("a write of the call has not ended"))
    with pytest.raises(asyncio.CancelledError):
        await refuse(context, REFUSAL)  # type: ignore[arg-type]
    assert context.told == [grpc.StatusCode.RESOURCE_EXHAUSTED]


async def test_abort_error_of_grpc_is_passed_on() -> None:
    with pytest.raises(grpc.aio.AbortError):
        await refuse(Context(grpc.aio.AbortError()), REFUSAL)  # type: ignore[arg-type]


async def test_no_status_is_sent_if_the_call_is_cancelled_first() -> None:
    context = Context(grpc.aio.AbortError())
    refusing = asyncio.ensure_future(refuse(context, REFUSAL))  # type: ignore[arg-type]
    await asyncio.sleep(0)  # the refusal has begun
    refusing.cancel()  # as gRPC does some iterations of the event loop later
    with pytest.raises(asyncio.CancelledError):
        await refusing
    assert context.told == []
