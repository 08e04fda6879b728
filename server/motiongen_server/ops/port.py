"""OpsPort: the HTTP port of a program, from the first connection to the last."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
from typing import Any

from starlette.applications import Starlette

from motiongen_server.addresses import join_address, network_of
from motiongen_server.ops.http import MOST_CONNECTIONS, OpsServer
from motiongen_server.ops.pace import CONNECTIONS_A_SECOND, CONNECTIONS_OF_AN_ADDRESS, AddressPaces
from motiongen_server.settings import SettingError

MOST_TURNED_AWAY = 64
"""At a time, before the event loop goes on with what else there is."""


class BoundedListener(socket.socket):
    """Has so many connections at most, those among them that have not come to the end of their TLS handshake.

    Of these a protocol hears nothing, and asyncio waits a minute for each: whoever only connects would take all
    descriptors. The oldest has to go. Who comes too often is turned away here, where no handshake has cost anything
    yet, and by its address, so that whoever floods keeps no orchestrator from its answer.
    """

    def __init__(self, listening: socket.socket) -> None:
        super().__init__(fileno=listening.detach())
        self._held: list[socket.socket] = []
        self._paces = AddressPaces(CONNECTIONS_A_SECOND, CONNECTIONS_OF_AN_ADDRESS)

    def accept(self) -> tuple[socket.socket, Any]:
        for _ in range(MOST_TURNED_AWAY):
            connection, address = super().accept()
            if self._paces.allows(network_of(address[0])):
                self._hold(connection)
                return connection, address
            connection.close()
        raise BlockingIOError  # asyncio asks again

    def _hold(self, connection: socket.socket) -> None:
        self._held = [held for held in self._held if held.fileno() >= 0]
        self._held.append(connection)
        if len(self._held) > MOST_CONNECTIONS:
            with contextlib.suppress(OSError):  # its client has gone
                self._held.pop(0).shutdown(socket.SHUT_RDWR)


class OpsPort:
    """port: the one that is served, once it is."""

    def __init__(self, app: Starlette, host: str, port: int, context: ssl.SSLContext | None = None) -> None:
        """context: of TLS; None: plain text."""
        self._app = app
        self._host = host
        self._context = context
        self.port = port

    async def start(self) -> None:
        """Listen. Raises SettingError where that cannot be."""
        host = self._host
        try:
            # Bound here, because uvicorn ends the process when it cannot.
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            listener = BoundedListener(socket.create_server((host, self.port), family=family))
        except OSError as error:
            address = join_address(host, self.port)
            raise SettingError(f"cannot listen on {address} (ops); choose another port, or 0: {error}") from error
        self._server = OpsServer(self._app, host, self.port, self._context)
        self._serving = asyncio.create_task(self._server.serve([listener]))
        while not self._server.started:
            if self._serving.done():
                self._serving.result()
            await asyncio.sleep(0.01)
        self.port = self._server.port

    async def stop(self) -> None:
        """End it."""
        self._server.should_exit = True
        await self._serving
