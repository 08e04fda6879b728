"""Health: gRPC's health checks. No watcher can keep others from a place, or a change from being told to them.

Who checks without end is answered at a pace (`health_pace`).
"""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import TypeAlias

import grpc
import grpc.aio
from grpc_health.v1 import health_pb2, health_pb2_grpc

from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.bounded_write import write_within
from motiongen_server.rpc.health_pace import HealthPace
from motiongen_server.rpc.peers import address_of
from motiongen_server.rpc.stream_errors import too_many_streams

MOST_WATCHERS = 512
MOST_OF_AN_ADDRESS = 128
"""A check that is asked for now and then needs no place."""
STUCK_S = 5.0

Context: TypeAlias = "grpc.aio.ServicerContext[health_pb2.HealthCheckRequest, health_pb2.HealthCheckResponse]"


class Health(health_pb2_grpc.HealthServicer):
    """The statuses of services by name, "" for the server as a whole. Lives on one event loop."""

    def __init__(self) -> None:
        self._statuses: dict[str, int] = {}
        self._changed = asyncio.Event()
        self._watchers: Counter[str] = Counter()
        self._pace = HealthPace()

    def set(self, service: str, status: int) -> None:
        """Tell a status to all who ask or watch. Waits for none of them."""
        self._statuses[service] = status
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    async def Check(self, request: health_pb2.HealthCheckRequest, context: Context) -> health_pb2.HealthCheckResponse:
        """The status now, told at a pace to who asks for it often."""
        try:
            await self._pace.wait(context.peer())
        except StreamRefused as refusal:
            await context.abort_with_status(refusal.status())
        status = self._statuses.get(request.service)
        if status is None:
            await context.abort(grpc.StatusCode.NOT_FOUND, f"no service {request.service[:80]!r} is served here")
        return health_pb2.HealthCheckResponse(status=status)

    async def Watch(self, request: health_pb2.HealthCheckRequest, context: Context) -> None:
        """The status now, and each that it changes to."""
        address = address_of(context.peer())
        try:
            if self._watchers.total() >= MOST_WATCHERS:
                raise too_many_streams(MOST_WATCHERS)
            if self._watchers[address] >= MOST_OF_AN_ADDRESS:
                raise too_many_streams(MOST_OF_AN_ADDRESS, "address")
            self._watchers[address] += 1
            try:
                await self._watch(request.service, context)
            finally:
                self._watchers[address] -= 1
                self._watchers += Counter()  # forgets who has none left
        except StreamRefused as refusal:
            await context.abort_with_status(refusal.status())

    async def _watch(self, service: str, context: Context) -> None:
        told = None
        while True:
            changed = self._changed
            status = self._statuses.get(service, health_pb2.HealthCheckResponse.SERVICE_UNKNOWN)
            if status != told:
                await write_within(STUCK_S, context.write(health_pb2.HealthCheckResponse(status=status)))
                told = status
            await changed.wait()
