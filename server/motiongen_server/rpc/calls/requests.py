"""Requests: awaits the request of calls that take one, with limits on the time and on how many calls may wait.

gRPC itself would wait for ever: it begins a call when its headers have come, and a client may send nothing else. So
methods with one request are served as streams of exactly one request, which is the same on the wire.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import OrderedDict, defaultdict
from collections.abc import Callable, Coroutine, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

import grpc.aio
from google.protobuf.message import DecodeError, Message

from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.budgets.peers import address_of
from motiongen_server.rpc.errors.calls import one_request_expected, request_late, request_too_long
from motiongen_server.rpc.errors.streams import failed_inside, malformed

M = TypeVar("M", bound=Message)
T = TypeVar("T")
Context: TypeAlias = "grpc.aio.ServicerContext[Any, Any]"
WITHIN_S = 5.0
"""A genuine gRPC client sends the request together with the headers, so it is there at once."""
MOST_WAITING = 512
MOST_WAITING_OF_AN_ADDRESS = 128
SMALL_REQUEST_BYTES = 4096
"""The default limit of a request: enough for a name, a path, and what later versions may add."""


@dataclass(eq=False, slots=True)
class AwaitedRequest:
    """A request that is awaited, or has come and is held in memory until its client closes its side.

    over: done once the wait has been ended. refusal: why, if not for lack of time. owed_s: seconds until its caller has
    paid. peer_name: of the peer that it counts for.
    """

    over: asyncio.Future[None]
    since: float
    num_waiting_bytes: int = 0
    refusal: StreamRefused | None = None
    owed_s: Callable[[float], float] = lambda _now: 0.0
    peer_name: str = ""

    def end(self) -> None:
        """End the wait."""
        if not self.over.done():
            self.over.set_result(None)

    def refuse(self, refusal: StreamRefused) -> None:
        """End the wait with a refusal; the request's bytes no longer count."""
        self.refusal, self.num_waiting_bytes = refusal, 0
        self.end()

    def fail(self, error: Exception) -> None:
        """End the wait because of a fault of the server's own, which is logged."""
        self.refuse(failed_inside("a call failed", "the call failed inside the server", error))

    async def until(self, read: Coroutine[Any, Any, T]) -> T:
        """Await a read. Raises StreamRefused if nothing comes in time, or the wait is ended before."""
        # The read is never cancelled, since gRPC would lose its message; it ends when the call ends.
        reading = asyncio.ensure_future(read)
        reading.add_done_callback(look_at)
        either: set[asyncio.Future[Any]] = {reading, self.over}
        await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
        if self.refusal is not None:
            raise self.refusal
        if not reading.done():
            raise request_late(time.monotonic() - self.since)
        return reading.result()


Arrive: TypeAlias = Callable[[AwaitedRequest], AbstractContextManager[None]]
"""Charges a request that has come, and counts it as held until it is complete."""


class Requests:
    """The awaited requests of a port. If too many wait, the oldest is refused: of the new one's address if that has too
    many itself.

    So no client can block others, not even those of its own address. Lives on one event loop.
    """

    def __init__(self, within_s: float = WITHIN_S) -> None:
        self._within_s = within_s
        self._all: OrderedDict[AwaitedRequest, None] = OrderedDict()
        self._of_address: defaultdict[str, OrderedDict[AwaitedRequest, None]] = defaultdict(OrderedDict)

    async def only(
        self, context: Context, most_bytes: int | None = SMALL_REQUEST_BYTES, arrive: Arrive | None = None
    ) -> bytes:
        """The request of a call. Raises StreamRefused if it does not come in time, is too long, or not the only one.

        most_bytes: allowed for it; None: as many as the port lets through. arrive: counts it; None: it is not counted.
        """
        with self._waiting(address_of(context.peer())) as waiting:
            request = await waiting.until(_first(context))
            waiting.num_waiting_bytes = len(request)
            with contextlib.nullcontext() if arrive is None else arrive(waiting):
                if most_bytes is not None and len(request) > most_bytes:
                    raise request_too_long(len(request), most_bytes)
                await waiting.until(_end(context))
        return request

    @contextlib.contextmanager
    def _waiting(self, address: str) -> Iterator[AwaitedRequest]:
        loop, of_address = asyncio.get_running_loop(), self._of_address[address]
        if len(of_address) >= MOST_WAITING_OF_AN_ADDRESS:
            _oldest(of_address).end()
        elif len(self._all) >= MOST_WAITING:
            _oldest(self._all).end()
        waiting = AwaitedRequest(loop.create_future(), time.monotonic())
        self._all[waiting] = of_address[waiting] = None
        timer = loop.call_later(self._within_s, waiting.end)
        try:
            yield waiting
        finally:
            timer.cancel()
            del self._all[waiting], of_address[waiting]
            if not of_address:
                self._of_address.pop(address, None)


def _oldest(waiting: OrderedDict[AwaitedRequest, None]) -> AwaitedRequest:
    return next((each for each in waiting if not each.over.done()), next(iter(waiting)))


async def _first(context: Context) -> bytes:
    request = await context.read()
    if not isinstance(request, bytes):  # grpc.aio.EOF
        raise one_request_expected("none")
    return request


async def _end(context: Context) -> None:
    if await context.read() is not grpc.aio.EOF:
        raise one_request_expected("more than one")


def look_at(done: asyncio.Future[Any]) -> None:
    """Callback for a task that may outlive its waiter: retrieves its exception, which asyncio would otherwise log."""
    if not done.cancelled():
        done.exception()


def parsed_as(kind: type[M], request: bytes) -> M:
    """Parse a message of that kind. Raises StreamRefused if it is malformed."""
    try:
        return kind.FromString(request)
    except DecodeError as error:
        raise malformed(str(error)) from error
