"""Makes gRPC servers, and serves methods on them, so that no call can end a server or fill its log.

gRPC decodes the names of methods that are not registered in the loop that begins all calls. A name that is not UTF-8,
which anybody can send without authentication, ends that loop, and with it the server and all its streams. So all
methods are registered, as these are found by the bytes of their names; the names of other calls are never decoded.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Coroutine, Iterator, Mapping, Sequence
from typing import Any, NoReturn

import grpc
import grpc.aio
from grpc._cython import cygrpc  # type: ignore[attr-defined]  # which has no stubs

from motiongen_server.rpc.calls.context import SEEN_GONE_S
from motiongen_server.rpc.calls.headers import HeaderTime, bounded

_NO_NAME = "not read"
"""Stands for a method's name."""


class _NamesUnread(cygrpc.AioServer):  # type: ignore[misc]
    """Refuses calls of methods that are not registered, with UNIMPLEMENTED, as gRPC does."""

    def _make_request_call_future(self, method: bytes | None) -> asyncio.Future[Any]:
        """The next call of a method. None: of one that is not registered; gRPC's loop never gets to see such a call."""
        if method is None:
            return asyncio.get_running_loop().create_task(self._refuse_others())
        future: asyncio.Future[Any] = super()._make_request_call_future(method)
        return future

    async def _refuse_others(self) -> NoReturn:
        """Refuse such calls until gRPC raises at the server's end."""
        loop, methods = asyncio.get_running_loop(), cygrpc._MethodResolver([], {})
        refusals: set[asyncio.Task[None]] = set()  # the event loop keeps only weak references to tasks
        while True:
            call = await self._request_call()
            refusing = _once_seen(cygrpc._handle_rpc(_NO_NAME, methods, (), call, loop, False))
            ending = cygrpc._schedule_rpc_coro(refusing, call, loop, _NO_NAME)
            refusals.add(task := loop.create_task(ending))
            task.add_done_callback(refusals.discard)


async def _once_seen(refusing: Coroutine[Any, Any, None]) -> None:
    """Refuse a call once gRPC has had time to see whether its client has gone; see `calls.context.end_with`."""
    try:
        await asyncio.sleep(SEEN_GONE_S)
        await refusing
    finally:
        refusing.close()


def make_server(options: Sequence[tuple[str, int]] = (), most_calls: int | None = None) -> grpc.aio.Server:
    """A server without methods or ports. most_calls: at once; None: unlimited."""
    # A logger adds the same filter only once.
    logging.getLogger(cygrpc.__name__).addFilter(_is_not_of_a_client)
    with _names_unread():
        return grpc.aio.server(options=list(options), maximum_concurrent_rpcs=most_calls)


def serve_methods(
    server: grpc.aio.Server, service: str, handlers: Mapping[str, grpc.RpcMethodHandler[Any, Any]]
) -> None:
    """Serve the methods of a service, before the server is started. service: its full name; handlers: by name.

    The headers of their calls are limited (`calls.headers`).
    """
    header_time = HeaderTime()
    server.add_registered_method_handlers(
        service, {name: bounded(handler, header_time) for name, handler in handlers.items()}
    )


@contextlib.contextmanager
def _names_unread() -> Iterator[None]:
    """Have gRPC make servers of that class within the block: there is no other way to give it one."""
    usual = cygrpc.AioServer
    cygrpc.AioServer = _NamesUnread
    try:
        yield
    finally:
        cygrpc.AioServer = usual


def _is_not_of_a_client(record: logging.LogRecord) -> bool:
    """False for log records that clients can cause at will, which gRPC logs as errors: metadata that is not UTF-8, in
    full and tokens too; and calls of unknown methods whose clients went away while they were refused.
    """
    said = str(record.msg)
    return not said.startswith("Invalid encoding") and not said.endswith(f"[{_NO_NAME}]")
