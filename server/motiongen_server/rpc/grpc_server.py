"""Servers of gRPC, and how methods are served on them: no call ends a server, and none writes its log.

gRPC reads the name of a method that was not registered in the loop that begins all calls. A name that is no UTF-8,
which anybody can send before he has said who he is, ends that loop, and with it the server and all its streams. So
methods are registered, which are found by the bytes of their names, and of all other calls nobody reads the name.

Nor are the headers of those read, and of others as `calls.headers` allows: gRPC reads them all before any method is
reached, on the event loop, so a call is refused before gRPC has it served.
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
from motiongen_server.rpc.calls.call_pace import CallPace
from motiongen_server.rpc.calls.context import end_with, refuse
from motiongen_server.rpc.calls.headers import HeaderTime
from motiongen_server.rpc.errors.streams import failed_inside

_NO_NAME = "not read"
"""In the place of a name."""


class _WaryServer(cygrpc.AioServer):  # type: ignore[misc]
    """Refuses calls of methods that are not registered, with UNIMPLEMENTED as gRPC does, and of too many headers.

    What it refuses is not among the calls that there may be at once: it is told so, and over, within milliseconds. Of
    calls that come faster than one address may begin them (`CallPace`) nobody is told anything: gRPC ends them.
    """

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self._header_times: defaultdict[bytes, HeaderTime] = defaultdict(HeaderTime)  # by service, as these
        self._paces: defaultdict[bytes, CallPace] = defaultdict(CallPace)
        self._refusals: set[asyncio.Task[None]] = set()  # the loop holds none

    def _make_request_call_future(self, method: bytes | None) -> asyncio.Future[Any]:
        """The next call of a method. None: of one that is not registered, of which gRPC hears no more."""
        return asyncio.get_running_loop().create_task(self._refuse_others() if method is None else self._next(method))

    async def _next(self, method: bytes) -> Any:
        """Raises what gRPC raises at the server's end."""
        service = method.rpartition(b"/")[0]
        pace, check_headers = self._paces[service], self._header_times[service].check
        while True:
            call = await self._request_registered_call(method)
            if self._may_begin(call, pace, check_headers):
                return call
            del call  # so gRPC ends what is not to be begun, and holds no headers until the next comes

    async def _refuse_others(self) -> NoReturn:
        """Raises what gRPC raises at the server's end."""
        pace = self._paces[b""]
        refusing = partial(end_with, code=grpc.StatusCode.UNIMPLEMENTED, details="Method not found!")
        while True:
            call = await self._request_call()
            if self._may_begin(call, pace):
                self._end(call, refusing)
            del call

    def _may_begin(self, call: Any, pace: CallPace, check: Callable[[Any], int] = lambda _: 0) -> bool:
        """Whether a call is to be served, or told anything. check: gives the number of its headers, or raises
        StreamRefused, which it is told of here.
        """
        try:
            context = _context_of(call)
            peer = context.peer()
            if not pace.allows(peer):
                return False
            pace.charge(peer, check(context))
        except StreamRefused as error:
            refusal = error
        except Exception as error:  # which would end the server from here
            refusal = failed_inside("a call was not begun", "the call failed inside the server", error)
        else:
            return True
        self._end(call, partial(refuse, refusal=refusal.with_traceback(None)))
        return False

    def _end(self, call: Any, refusing: Callable[[Any], Coroutine[Any, Any, NoReturn]]) -> None:
        """Have a call refused, unless its client is seen to have gone; see `calls.context.end_with`."""
        loop = asyncio.get_running_loop()
        ending = cygrpc._schedule_rpc_coro(refusing(_context_of(call)), call, loop, _NO_NAME)
        self._refusals.add(task := loop.create_task(ending))
        task.add_done_callback(self._refusals.discard)


def _context_of(call: Any) -> Any:
    """What the method of a call is given."""
    return cygrpc._ServicerContext(call, None, None, asyncio.get_running_loop())


def make_server(options: Sequence[tuple[str, int]] = (), most_calls: int | None = None) -> grpc.aio.Server:
    """A server without methods and ports. most_calls: at once; None: without a limit."""
    # A logger takes a filter once, however often it is given.
    logging.getLogger(cygrpc.__name__).addFilter(_is_not_of_a_client)
    with _wary():
        return grpc.aio.server(options=list(options), maximum_concurrent_rpcs=most_calls)


def serve_methods(
    server: grpc.aio.Server, service: str, handlers: Mapping[str, grpc.RpcMethodHandler[Any, Any]]
) -> None:
    """Serve the methods of a service, before the server is started. service: its full name; handlers: by name.

    Calls of them have so many headers at most (`calls.headers`).
    """
    server.add_registered_method_handlers(service, dict(handlers))


@contextlib.contextmanager
def _wary() -> Iterator[None]:
    """Servers that gRPC makes within are of that kind: there is no other way to give it one."""
    usual = cygrpc.AioServer
    cygrpc.AioServer = _WaryServer
    try:
        yield
    finally:
        cygrpc.AioServer = usual


def _is_not_of_a_client(record: logging.LogRecord) -> bool:
    """gRPC logs metadata that is no UTF-8 as an error, as often as clients like, and whole, tokens too."""
    return not str(record.msg).startswith("Invalid encoding")
