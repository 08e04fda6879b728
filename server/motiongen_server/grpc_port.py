"""GrpcPort: the gRPC port of a server and what is served on it; it can be shut for a while and opened again."""

from __future__ import annotations

import asyncio
import contextlib
import logging

import grpc
import grpc.aio

from motiongen_server.addresses import join_address
from motiongen_server.config import ServerConfig
from motiongen_server.identity.setup import listen
from motiongen_server.identity.tls import ServerTls
from motiongen_server.rpc.calls.health import SERVICE_NAME as HEALTH_NAME
from motiongen_server.rpc.calls.health import Health, add_health
from motiongen_server.rpc.calls.reflection import add_reflection
from motiongen_server.rpc.calls.requests import Requests
from motiongen_server.rpc.handlers import SERVICE_NAME, Handlers, add_methods
from motiongen_server.settings import SettingError
from motiongen_server.transport import make_grpc_server

_log = logging.getLogger(__name__)

TRY_AGAIN_S = 1.0
"""Between attempts to open the port again."""


class GrpcPort:
    """number: the port that is served, once it is open; it stays the same when it is opened again."""

    def __init__(self, config: ServerConfig, tls: ServerTls | None, methods: Handlers, health: Health) -> None:
        """tls: None: plain text."""
        self._config = config
        self._tls = tls
        self._methods = methods
        self._health = health
        self._server: grpc.aio.Server | None = None
        self._ending: asyncio.Task[None] | None = None
        self._outliving: asyncio.Task[None] | None = None
        self.number = config.port

    @property
    def is_open(self) -> bool:
        """Whether it listens."""
        return self._server is not None

    async def open(self) -> None:
        """Listen and serve. Raises SettingError if it cannot listen."""
        if self._ending is not None:
            await self._ending
        server, requests = make_grpc_server(self._config), Requests(self._config.hello_timeout_s)
        add_methods(self._methods, server, requests)
        add_health(self._health, server, requests)
        if self._config.reflection:
            add_reflection((SERVICE_NAME, HEALTH_NAME), server, requests)
        try:
            self.number = listen(server, join_address(self._config.host, self.number), "", self._tls)
            await server.start()
        except BaseException:
            await server.stop(None)
            raise
        self._server = server
        self._outliving = asyncio.create_task(self._outlive(server))

    async def _outlive(self, server: grpc.aio.Server) -> None:
        """Open the port again if its server ends by itself, because of a fault in gRPC: else nobody could connect."""
        with contextlib.suppress(Exception):  # gRPC logs it
            # Shielded: cancelling it would also cancel gRPC's own wait for the end.
            await asyncio.shield(server.wait_for_termination())
        while self._server is server:
            _log.error("the gRPC server has ended by itself, and with it all streams; the port is opened again")
            try:
                await self.open()
            except SettingError as error:
                _log.error("%s; trying again", error)
                await asyncio.sleep(TRY_AGAIN_S)

    def shut(self, grace_s: float | None) -> None:
        """Accept no more connections. Open calls continue, and are cancelled after `grace_s`; None: at once."""
        if self._outliving is not None:
            self._outliving.cancel()
        if self._server is not None:
            self._ending = asyncio.create_task(self._server.stop(grace_s))
            self._server = None

    async def close(self, grace_s: float | None) -> None:
        """Like `shut`; returns when no call is left."""
        self.shut(grace_s)
        if self._ending is not None:
            await self._ending
