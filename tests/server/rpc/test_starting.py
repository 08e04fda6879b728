"""Calls to a server whose model is not loaded, or whose engines are lost: refused, and passed on once it is open."""

from __future__ import annotations

import asyncio
from typing import Any

import grpc
import grpc.aio
import pytest

from motiongen.v1 import service_pb2
from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.starting import StartingService


class Service:
    """Notes the calls that it is given."""

    def __init__(self) -> None:
        self.catalog = service_pb2.GetCatalogResponse()
        self.given: list[tuple[object, ...]] = []

    async def GetCatalog(self, call: object) -> service_pb2.GetCatalogResponse:
        self.given.append((call,))
        return self.catalog

    async def StreamMotion(self, requests: object, context: object) -> None:
        self.given.append((requests, context))

    async def GenerateClip(self, call: object) -> None:
        self.given.append((call,))


class Context:
    """Of a stream; told: the statuses that it was ended with."""

    def __init__(self) -> None:
        self.told: list[tuple[grpc.StatusCode, str]] = []

    async def abort(self, code: grpc.StatusCode, details: str, trailing_metadata: object) -> None:
        self.told.append((code, details))
        raise grpc.aio.AbortError

    async def abort_with_status(self, status: grpc.Status) -> None:
        await self.abort(status.code, status.details or "", status.trailing_metadata)


async def refusal_of(waiting: Any) -> StreamRefused:
    with pytest.raises(StreamRefused) as refused:
        await waiting
    return refused.value


async def expect_refusals(door: StartingService) -> None:
    """Whatever is called, the client is to try again in a second."""
    call, context = object(), Context()
    for refusal in (
        await refusal_of(door.GetCatalog(call)),  # type: ignore[arg-type]
        await refusal_of(door.GenerateClip(call)),  # type: ignore[arg-type]
    ):
        assert (refusal.code, refusal.reason) == (grpc.StatusCode.UNAVAILABLE, "STARTING")
        assert refusal.retry_after_s == 1.0
    with pytest.raises(grpc.aio.AbortError):
        await door.StreamMotion(object(), context)  # type: ignore[arg-type]
    ((code, details),) = context.told
    assert code is grpc.StatusCode.UNAVAILABLE
    assert "try again when its health is SERVING" in details


async def test_calls_are_refused_before_the_service_exists_and_while_it_is_unavailable() -> None:
    door, service = StartingService(), Service()
    assert not door.is_open
    await expect_refusals(door)
    door.open(service)  # type: ignore[arg-type]
    assert door.is_open
    door.shut()
    assert not door.is_open
    await expect_refusals(door)
    assert service.given == []


async def test_calls_are_passed_on_unchanged_once_the_service_exists() -> None:
    door, service = StartingService(), Service()
    door.open(service)  # type: ignore[arg-type]
    calls: list[Any] = [object() for _ in range(4)]
    assert await door.GetCatalog(calls[0]) is service.catalog
    await door.GenerateClip(calls[1])
    await door.StreamMotion(calls[2], calls[3])
    assert service.given == [(calls[0],), (calls[1],), (calls[2], calls[3])]


async def test_stream_whose_client_is_gone_is_sent_no_status() -> None:
    """gRPC would keep the memory of a status that it cannot deliver."""
    context = Context()
    serving = asyncio.ensure_future(StartingService().StreamMotion(object(), context))  # type: ignore[arg-type]
    await asyncio.sleep(0)  # it has begun
    serving.cancel()  # as gRPC does some rounds of the event loop later
    with pytest.raises(asyncio.CancelledError):
        await serving
    assert context.told == []
