"""Makes gRPC servers, and serves methods on them, so that no call can end a server or fill its log.

gRPC decodes the names of methods that are not registered in the loop that begins all calls. A name that is not UTF-8,
which anybody can send without authentication, ends that loop, and with it the server and all its streams. So all
methods are registered, as these are found by the bytes of their names; the names of other calls are never decoded.

Nor are the headers of such calls read, and those of others only as far as `calls.headers` allows: gRPC reads all
headers of a call on the event loop before any method is reached, so calls are refused before gRPC serves them.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import defaultdict
from collections.abc import Callable, Coroutine, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NoReturn

import grpc
import grpc.aio
from grpc._cython import cygrpc  # type: ignore[attr-defined]  # which has no stubs

from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.calls.call_pace import CALLS_A_SECOND, CallPace
from motiongen_server.rpc.calls.context import end_with, refuse
from motiongen_server.rpc.calls.headers import HeaderTime
from motiongen_server.rpc.errors.streams import failed_inside

_NO_NAME = "not read"
"""Stands for a method's name."""


class _WaryServer(cygrpc.AioServer):  # type: ignore[misc]
    """Refuses calls of methods that are not registered (UNIMPLEMENTED, as gRPC does), and calls with too many headers.

    Refused calls do not count towards the limit of concurrent calls: they end within milliseconds. Calls that an
    address begins faster than it may (`CallPace`) get no answer of ours: gRPC ends them.
    """

    def __init__(self, *given: Any, calls_a_second: float) -> None:
        """given: by gRPC. calls_a_second: of a service, that an address may begin."""
        super().__init__(*given)
        self._header_times: defaultdict[bytes, HeaderTime] = defaultdict(HeaderTime)  # by service
        self._paces: defaultdict[bytes, CallPace] = defaultdict(partial(CallPace, calls_a_second))
        self._refusals: set[asyncio.Task[None]] = set()  # the event loop keeps only weak references to tasks

    def _make_request_call_future(self, method: bytes | None) -> asyncio.Future[Any]:
        """The next call of a method. None: of one that is not registered; gRPC's loop never gets to see such a call."""
        return asyncio.get_running_loop().create_task(self._refuse_others() if method is None else self._next(method))

    async def _next(self, method: bytes) -> Any:
        """The next call that is to be served. Raises what gRPC raises when the server ends."""
        service = method.rpartition(b"/")[0]
        pace, check_headers = self._paces[service], self._header_times[service].check
        while True:
            call = await self._request_registered_call(method)
            if self._may_begin(call, pace, check_headers):
                return call
            del call  # so that gRPC ends it, and holds none of its headers until the next call comes

    async def _refuse_others(self) -> NoReturn:
        """Refuse calls of methods that are not registered. Raises what gRPC raises when the server ends."""
        pace = self._paces[b""]
        refusing = partial(end_with, code=grpc.StatusCode.UNIMPLEMENTED, details="Method not found!")
        while True:
            call = await self._request_call()
            if self._may_begin(call, pace):
                self._end(call, refusing)
            del call

    def _may_begin(self, call: Any, pace: CallPace, check: Callable[[Any], int] = lambda _: 0) -> bool:
        """Whether a call may go on; one that may not is refused, or dropped if its address begins too many.

        check: returns the number of its headers, or raises StreamRefused.
        """
        try:
            context = _context_of(call)
            peer = context.peer()
            if not pace.allows(peer):
                return False
            pace.charge(peer, check(context))
        except StreamRefused as error:
            refusal = error
        except Exception as error:  # raised in gRPC's loop, it would end the server
            refusal = failed_inside("a call was not begun", "the call failed inside the server", error)
        else:
            return True
        self._end(call, partial(refuse, refusal=refusal.with_traceback(None)))
        return False

    def _end(self, call: Any, refusing: Callable[[Any], Coroutine[Any, Any, NoReturn]]) -> None:
        """Refuse a call in a task of its own, unless its client has gone; see `calls.context.end_with`."""
        loop = asyncio.get_running_loop()
        ending = cygrpc._schedule_rpc_coro(refusing(_context_of(call)), call, loop, _NO_NAME)
        self._refusals.add(task := loop.create_task(ending))
        task.add_done_callback(self._refusals.discard)


def _context_of(call: Any) -> Any:
    """The context that the method of a call would get."""
    return cygrpc._ServicerContext(call, None, None, asyncio.get_running_loop())


def make_server(
    options: Sequence[tuple[str, int]] = (), most_calls: int | None = None, calls_a_second: float = CALLS_A_SECOND
) -> grpc.aio.Server:
    """A server without methods or ports.

    most_calls: at once; None: unlimited. calls_a_second: of a service, that an address may begin (`CallPace`).
    """
    # A logger adds the same filter only once.
    logging.getLogger(cygrpc.__name__).addFilter(_is_not_of_a_client)
    with _wary(calls_a_second):
        return grpc.aio.server(options=list(options), maximum_concurrent_rpcs=most_calls)


def serve_methods(
    server: grpc.aio.Server, service: str, handlers: Mapping[str, grpc.RpcMethodHandler[Any, Any]]
) -> None:
    """Serve the methods of a service, before the server is started. service: its full name; handlers: by name.

    The headers of their calls are limited (`calls.headers`).
    """
    server.add_registered_method_handlers(service, dict(handlers))


@contextlib.contextmanager
def _wary(calls_a_second: float) -> Iterator[None]:
    """Have gRPC make servers of that class within the block: there is no other way to give it one."""
    usual = cygrpc.AioServer
    cygrpc.AioServer = partial(_WaryServer, calls_a_second=calls_a_second)
    try:
        yield
    finally:
        cygrpc.AioServer = usual


def _is_not_of_a_client(record: logging.LogRecord) -> bool:
    """False for log records that clients can cause at will, which gRPC logs as errors: metadata that is not UTF-8, in
    full and tokens too.
    """
    return not str(record.msg).startswith("Invalid encoding")
