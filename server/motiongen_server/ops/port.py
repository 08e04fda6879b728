"""OpsPort: a program's HTTP port for health and metrics, and the limits of its connections."""

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
"""Connections turned away in a row before the event loop continues with other work."""


class BoundedListener(socket.socket):
    """Holds at most `MOST_CONNECTIONS`, including those whose TLS handshake has not finished, and limits their rate.

    A protocol learns nothing of unfinished handshakes, and asyncio waits a minute for each: clients that only connect
    would use up all file descriptors. So the oldest connection is shut down when there are too many. Connections beyond
    the rate limits are closed here, before a handshake costs anything, and by address, so that a client that floods
    does not keep orchestrators from their answers.
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
        raise BlockingIOError  # asyncio calls again

    def _hold(self, connection: socket.socket) -> None:
        self._held = [held for held in self._held if held.fileno() >= 0]
        self._held.append(connection)
        if len(self._held) > MOST_CONNECTIONS:
            with contextlib.suppress(OSError):  # its client has disconnected
                self._held.pop(0).shutdown(socket.SHUT_RDWR)


class OpsPort:
    """port: the port that is served, once `start` has returned."""

    def __init__(self, app: Starlette, host: str, port: int, context: ssl.SSLContext | None = None) -> None:
        """context: for TLS; None: plain text."""
        self._app = app
        self._host = host
        self._context = context
        self.port = port

    async def start(self) -> None:
        """Listen and serve. Raises SettingError if it cannot listen."""
        host = self._host
        try:
            # Bound here, because uvicorn ends the process if it cannot bind.
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
        """Stop serving."""
        self._server.should_exit = True
        await self._serving
