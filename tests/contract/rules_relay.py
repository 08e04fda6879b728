"""A server that relays to another one, and checks every rule on what passes through."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import grpc
import grpc.aio

from motiongen.v1 import service_pb2, service_pb2_grpc
from motiongen_compliance.heard import RuleBroken
from tests.contract.client_rules import StreamRules, Told

Requests = AsyncIterator[service_pb2.StreamMotionRequest]
PROBE = service_pb2.StreamMotionResponse()
"""Written when a client seems to have finished writing: so does one with a lost connection, and only a write tells."""


class RulesRelay(service_pb2_grpc.MotionServiceServicer):
    """Use as `async with RulesRelay(address) as relay`. address: where it listens.

    broken: rules that a client or the server has broken; streams: all so far; kept: sessions by their tokens.
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
        said: asyncio.Queue[service_pb2.StreamMotionResponse | None] = asyncio.Queue()
        tasks = [
            asyncio.create_task(self._forward(request_iterator, call, rules, said)),
            asyncio.create_task(self._listen(call, said)),
        ]
        try:
            while (response := await said.get()) is not None:
                if response is PROBE:
                    yield service_pb2.StreamMotionResponse()
                    await call.done_writing()
                    continue
                self._note(lambda response=response: rules.hear(response))
                yield response
            if await call.code() is not grpc.StatusCode.OK:
                await context.abort(await call.code(), await call.details())
        finally:
            call.cancel()
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _forward(
        self,
        requests: Requests,
        call: grpc.aio.StreamStreamCall,
        rules: StreamRules,
        said: asyncio.Queue[service_pb2.StreamMotionResponse | None],
    ) -> None:
        async for request in requests:
            self._note(lambda request=request: rules.say(request))
            await call.write(request)
        said.put_nowait(PROBE)

    @staticmethod
    async def _listen(
        call: grpc.aio.StreamStreamCall, said: asyncio.Queue[service_pb2.StreamMotionResponse | None]
    ) -> None:
        try:
            async for response in call:
                said.put_nowait(response)
        finally:
            said.put_nowait(None)

    def _note(self, check: object) -> None:
        try:
            check()  # type: ignore[operator]
        except RuleBroken as broken:
            self.broken.append(str(broken))
