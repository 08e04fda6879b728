"""Health checks and metrics over HTTP, for orchestrators and Prometheus."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import ssl
from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import ClassVar

import uvicorn
from h11 import ProtocolError
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route
from uvicorn.protocols.http.h11_impl import H11Protocol

from motiongen_server.ops.pace import Pace

LIFE_S = 30.0
_HEAD_END, _HEAD_END_BYTES = re.compile(rb"\n\r?\n"), 2  # the bytes of it that earlier data may hold
MOST_CONNECTIONS = 64
RENDERINGS_A_SECOND = 5
"""Of the metrics, each of which takes milliseconds; more frequent requests get the last rendering."""
END_S = 2
"""Seconds that requests in progress may still take when the server ends."""


def ops_app(
    registry: CollectorRegistry,
    is_alive: Callable[[], bool],
    is_ready: Callable[[], bool],
    refusal_of: Callable[[str], str | None] = lambda _: None,
) -> Starlette:
    """/livez and /healthz: the process works; /readyz: it takes sessions; /metrics: Prometheus text.

    refusal_of: why the sender of an `Authorization` header may not read the metrics, in words; None if it may.
    """

    pace, rendered = Pace(RENDERINGS_A_SECOND), b""

    async def live(_request: Request) -> Response:
        return _answer(is_alive())

    async def ready(_request: Request) -> Response:
        return _answer(is_ready())

    async def metrics(request: Request) -> Response:
        refusal = refusal_of(", ".join(request.headers.getlist("authorization")))  # if there are several, none counts
        if refusal is not None:
            return PlainTextResponse(f"{refusal}\n", status_code=401, headers={"WWW-Authenticate": "Bearer"})
        nonlocal rendered
        if pace.allows():
            rendered = generate_latest(registry)
        return Response(rendered, media_type=CONTENT_TYPE_LATEST)

    return Starlette(
        routes=[
            Route("/livez", live),
            Route("/healthz", live),
            Route("/readyz", ready),
            Route("/metrics", metrics),
        ]
    )


def _answer(well: bool) -> Response:
    return PlainTextResponse("ok\n" if well else "not ok\n", status_code=200 if well else 503)


def _is_for_operators(record: logging.LogRecord) -> bool:
    """Not what clients can cause as often as they like: uvicorn's warnings of invalid requests, and its errors when it
    answers a request whose body is invalid (ProtocolError). The server's own faults are errors too.
    """
    fault = record.exc_info[1] if record.exc_info else None
    return record.levelno != logging.WARNING and not isinstance(fault, ProtocolError)


class BoundedConnection(H11Protocol):
    """A connection for one request, open for `LIFE_S` at most; beyond `MOST_CONNECTIONS` the oldest one is aborted.

    Otherwise a client that only connects, sends its request a byte at a time, or does not read the answer could hold a
    place for ever, and delay the end of the server.
    """

    open_ones: ClassVar[OrderedDict[H11Protocol, None]] = OrderedDict()

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._end = self.loop.call_later(LIFE_S, transport.abort)
        self._last, self._has_head = b"", False
        self.open_ones[self] = None
        if len(self.open_ones) > MOST_CONNECTIONS:
            oldest, _ = self.open_ones.popitem(last=False)
            oldest.transport.abort()

    def data_received(self, data: bytes) -> None:
        if self._has_head:
            return  # a body is ignored: one in chunks of a byte would take half a second of the event loop
        known = len(self._last)
        end = _HEAD_END.search(self._last + data)
        self._last = (self._last + data)[-_HEAD_END_BYTES:]
        self._has_head = end is not None
        try:
            super().data_received(data if end is None else data[: end.end() - known])
        except ProtocolError:  # uvicorn wants to refuse an invalid request that it has already begun to answer
            self.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._end.cancel()
        self.open_ones.pop(self, None)
        super().connection_lost(exc)


class OpsServer(uvicorn.Server):
    """uvicorn in the application's event loop; signals are left to the application."""

    def __init__(self, app: Starlette, host: str, port: int, context: ssl.SSLContext | None = None) -> None:
        """context: for TLS; None: plain text."""
        logging.getLogger("uvicorn.error").addFilter(_is_for_operators)
        super().__init__(
            uvicorn.Config(
                app,
                host=host,
                port=port,
                http=BoundedConnection,
                ws="none",
                log_config=None,
                log_level="warning",
                lifespan="off",
                access_log=False,
                timeout_graceful_shutdown=END_S,
                headers=[("Connection", "close")],
                ssl_context_factory=None if context is None else lambda *_: context,
            )
        )

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave signals to the application, which stops this server last."""
        yield

    @property
    def port(self) -> int:
        """The port that is served; it differs from the requested one if that was 0."""
        return int(self.servers[0].sockets[0].getsockname()[1])
