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
_HEAD_END, _HEAD_END_BYTES = re.compile(rb"\n\r?\n"), 2  # without the last byte: that comes with other data
MOST_CONNECTIONS = 64
RENDERINGS_A_SECOND = 5
"""Of the metrics, which take milliseconds; who asks more often gets those of just before."""
END_S = 2
"""Seconds that requests under way may take once the server ends."""


def ops_app(
    registry: CollectorRegistry,
    is_alive: Callable[[], bool],
    is_ready: Callable[[], bool],
    refusal_of: Callable[[str], str | None] = lambda _: None,
) -> Starlette:
    """/livez and /healthz: the process works; /readyz: it takes sessions; /metrics: Prometheus text.

    refusal_of: why who sends that `Authorization` header may not read the metrics, in words; None: he may.
    """

    pace, rendered = Pace(RENDERINGS_A_SECOND), b""

    async def live(_request: Request) -> Response:
        return _answer(is_alive())

    async def ready(_request: Request) -> Response:
        return _answer(is_ready())

    async def metrics(request: Request) -> Response:
        refusal = refusal_of(", ".join(request.headers.getlist("authorization")))  # of several none counts
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
    """uvicorn warns of each request that is none, as often as clients like; faults of the server's own are errors.

    So is, for uvicorn, an answer that comes when the request's body has turned out to be none.
    """
    fault = record.exc_info[1] if record.exc_info else None
    return record.levelno != logging.WARNING and not isinstance(fault, ProtocolError)


class BoundedConnection(H11Protocol):
    """A connection of one request, that lives for a while; there are so many at most.

    Whoever only connects, says its request a byte at a time, or does not read the answer, would else hold a place for
    ever, and the server's end up.
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
            return  # a body, which nothing here takes: in chunks of a byte it would cost the event loop half a second
        known = len(self._last)
        end = _HEAD_END.search(self._last + data)
        self._last = (self._last + data)[-_HEAD_END_BYTES:]
        self._has_head = end is not None
        try:
            super().data_received(data if end is None else data[: end.end() - known])
        except ProtocolError:  # uvicorn's own answer to what is no request, of one that it has begun to answer
            self.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._end.cancel()
        self.open_ones.pop(self, None)
        super().connection_lost(exc)


class OpsServer(uvicorn.Server):
    """uvicorn inside the application's event loop, which keeps its own signal handlers."""

    def __init__(self, app: Starlette, host: str, port: int, context: ssl.SSLContext | None = None) -> None:
        """context: of TLS; None: plain text."""
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
        """Leave signals to the application, which ends this server last."""
        yield

    @property
    def port(self) -> int:
        """The port that is served, which differs from the one asked for when that was 0."""
        return int(self.servers[0].sockets[0].getsockname()[1])
