"""Calls that are refused when their client has just gone."""

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
    """Of a call that ends as it is told to."""

    def __init__(self, error: Exception) -> None:
        self.told: list[grpc.StatusCode] = []
        self._error = error

    async def abort(self, code: grpc.StatusCode, details: str, trailing_metadata: Any) -> None:
        self.told.append(code)
        raise self._error


async def test_a_call_whose_client_has_gone_is_cancelled_and_no_fault_of_the_server() -> None:
    context = Context(grpc.aio.InternalError("a write of the call has not ended"))
    with pytest.raises(asyncio.CancelledError):
        await refuse(context, REFUSAL)  # type: ignore[arg-type]
    assert context.told == [grpc.StatusCode.RESOURCE_EXHAUSTED]


async def test_what_grpc_ends_a_call_by_is_left_to_it() -> None:
    with pytest.raises(grpc.aio.AbortError):
        await refuse(Context(grpc.aio.AbortError()), REFUSAL)  # type: ignore[arg-type]


async def test_nobody_is_told_where_the_client_is_seen_to_have_gone() -> None:
    context = Context(grpc.aio.AbortError())
    refusing = asyncio.ensure_future(refuse(context, REFUSAL))  # type: ignore[arg-type]
    await asyncio.sleep(0)  # it has begun
    refusing.cancel()  # as gRPC does some rounds of the event loop later
    with pytest.raises(asyncio.CancelledError):
        await refusing
    assert context.told == []
