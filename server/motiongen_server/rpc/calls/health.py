"""Health: gRPC's health checks. No watcher can take up all places, or delay a change of status for others.

Callers that check incessantly are answered at a limited pace (`health_pace`).
"""

from __future__ import annotations

import asyncio

import grpc
import grpc.aio
from grpc_health.v1 import health_pb2

from motiongen_server.rpc.budgets.call_places import CallPlaces
from motiongen_server.rpc.budgets.peers import address_of
from motiongen_server.rpc.calls.bounded_write import write_within
from motiongen_server.rpc.calls.context import CallContext, streaming_method, unary_method
from motiongen_server.rpc.calls.health_pace import HealthPace
from motiongen_server.rpc.calls.requests import Requests, parsed_as
from motiongen_server.rpc.grpc_server import serve_methods
from motiongen_server.rpc.limits import HEALTH_CALLS

MOST_WATCHES = 512
MOST_OF_AN_ADDRESS = 128
"""Watches."""
CALLS_OF_AN_ADDRESS = 384
"""Watches, and checks that wait for their turn or for their request; a check that has been answered is over."""
STUCK_S = 5.0
SERVICE = health_pb2.DESCRIPTOR.services_by_name["Health"]
SERVICE_NAME = SERVICE.full_name


class Health:
    """The statuses of services by name, "" for the server as a whole. Lives on one event loop."""

    def __init__(self) -> None:
        self._statuses: dict[str, int] = {}
        self._changed = asyncio.Event()
        self._watches = CallPlaces(MOST_WATCHES)
        self._places = CallPlaces(HEALTH_CALLS)
        self._pace = HealthPace()

    def set(self, service: str, status: int) -> None:
        """Set a status for all who check or watch. Does not wait for any of them."""
        if self._statuses.get(service) == status:
            return
        self._statuses[service] = status
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    async def Check(self, call: CallContext) -> health_pb2.HealthCheckResponse:
        """The status now. A caller that asks often has to wait. Raises StreamRefused."""
        request = await self._request(call)
        status = self._statuses.get(request.service)
        if status is None:
            await call.abort(grpc.StatusCode.NOT_FOUND, f"no service {request.service[:80]!r} is served here")
        return health_pb2.HealthCheckResponse(status=status)

    async def Watch(self, call: CallContext) -> None:
        """The status now, and again whenever it changes. Raises StreamRefused."""
        request = await self._request(call)
        call.hold(self._watches.take(address_of(call.peer()), call.peer(), MOST_OF_AN_ADDRESS))
        await self._watch(request.service, call)

    async def _request(self, call: CallContext) -> health_pb2.HealthCheckRequest:
        """The request, once it is the caller's turn. Raises StreamRefused."""
        call.hold(self._places.take(address_of(call.peer()), call.peer(), CALLS_OF_AN_ADDRESS))
        await self._pace.wait(call.peer())
        return parsed_as(health_pb2.HealthCheckRequest, await call.request())

    async def _watch(self, service: str, call: CallContext) -> None:
        told = None
        while True:
            changed = self._changed
            status = self._statuses.get(service, health_pb2.HealthCheckResponse.SERVICE_UNKNOWN)
            if status != told:
                await write_within(STUCK_S, call.write(health_pb2.HealthCheckResponse(status=status)))
                told = status
            await changed.wait()


def add_health(health: Health, server: grpc.aio.Server, requests: Requests | None = None) -> None:
    """Serve health. requests: shared by all calls of that server."""
    requests = requests or Requests()
    handlers = {"Check": unary_method(health.Check, requests), "Watch": streaming_method(health.Watch, requests)}
    serve_methods(server, SERVICE_NAME, handlers)
