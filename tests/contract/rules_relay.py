"""A server that is another server, with every rule checked on what goes through it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

import grpc
import grpc.aio

from motiongen.v1 import service_pb2, service_pb2_grpc
from motiongen_compliance.heard import RuleBroken
from tests.contract.client_rules import StreamRules, Told

Requests = AsyncIterator[service_pb2.StreamMotionRequest]


class RulesRelay(service_pb2_grpc.MotionServiceServicer):
    """Use as `async with RulesRelay(address) as relay`. address: where it listens.

    broken: rules that a client or the server has broken; streams: all that there were; kept: sessions by their tokens.
    """

    def __init__(self, behind: str) -> None:
        self._behind = behind
        self.broken: list[str] = []
        self.streams: list[StreamRules] = []
        self.kept: dict[str, Told] = {}

    async def __aenter__(self) -> RulesRelay:
        self._channel = grpc.aio.insecure_channel(self._behind)
        self._stub = service_pb2_grpc.MotionServiceStub(self._channel)
        self._catalog = await self._stub.GetCatalog(service_pb2.GetCatalogRequest())
        self._server = grpc.aio.server()
        service_pb2_grpc.add_MotionServiceServicer_to_server(self, self._server)
        self.address = f"127.0.0.1:{self._server.add_insecure_port('127.0.0.1:0')}"
        await self._server.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._server.stop(None)
        await self._channel.close()

    async def GetCatalog(
        self, request: service_pb2.GetCatalogRequest, context: grpc.aio.ServicerContext
    ) -> service_pb2.GetCatalogResponse:
        return await self._stub.GetCatalog(request)

    async def StreamMotion(
        self, request_iterator: Requests, context: grpc.aio.ServicerContext
    ) -> AsyncIterator[service_pb2.StreamMotionResponse]:
        rules = StreamRules(self._catalog, self.kept)
        self.streams.append(rules)
        call = self._stub.StreamMotion()
        forward = asyncio.create_task(self._forward(request_iterator, context, call, rules))
        try:
            async for response in call:
                self._note(lambda response=response: rules.hear(response))
                yield response
        finally:
            forward.cancel()
            call.cancel()
            with contextlib.suppress(asyncio.CancelledError, asyncio.InvalidStateError, grpc.RpcError):
                await forward

    async def _forward(
        self,
        requests: Requests,
        context: grpc.aio.ServicerContext,
        call: grpc.aio.StreamStreamCall,
        rules: StreamRules,
    ) -> None:
        async for request in requests:
            self._note(lambda request=request: rules.say(request))
            await call.write(request)
        if not context.cancelled() and not context.done():  # one whose line is lost has not finished
            await call.done_writing()

    def _note(self, check: object) -> None:
        try:
            check()  # type: ignore[operator]
        except RuleBroken as broken:
            self.broken.append(str(broken))
