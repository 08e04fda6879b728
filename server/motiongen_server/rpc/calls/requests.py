"""Requests: the one request of each call that takes one, awaited for a while, and for so many calls at once.

gRPC would wait for ever: it begins a call when its headers have come, and a client may send nothing else. So methods of
one request are served as streams of requests, of which there has to be one; on the wire that is the same.
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
"""A client of gRPC sends the request with the headers: it is there at once, or its client is none."""
MOST_WAITING = 512
MOST_WAITING_OF_AN_ADDRESS = 128
SMALL_REQUEST_BYTES = 4096
"""That a request may have where its method says nothing else: a name, a path, and what later versions may add."""


@dataclass(eq=False, slots=True)
class AwaitedRequest:
    """What has come of a request, and is held in memory until its client has ended its side.

    over: set once it is not waited for any longer. refusal: why, where it is not for its time. owed_s: seconds until
    its caller has paid.
    """

    over: asyncio.Future[None]
    since: float
    num_waiting_bytes: int = 0
    refusal: StreamRefused | None = None
    owed_s: Callable[[float], float] = lambda _now: 0.0

    def end(self) -> None:
        """Wait no longer."""
        if not self.over.done():
            self.over.set_result(None)

    def refuse(self, refusal: StreamRefused) -> None:
        """End it, and count nothing more of it."""
        self.refusal, self.num_waiting_bytes = refusal, 0
        self.end()

    def fail(self, error: Exception) -> None:
        """End it for a fault of the server's own, which is logged."""
        self.refuse(failed_inside("a call failed", "the call failed inside the server", error))

    async def until(self, read: Coroutine[Any, Any, T]) -> T:
        """What is read. Raises StreamRefused where it does not come in time, or this is ended before."""
        # What is read is never cancelled, since gRPC would lose it: a call that is ended ends its reading.
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
"""What a request that has come is charged to, and counted in until it is complete."""


class Requests:
    """Of the calls of a port. Where too many wait, the one that has waited longest goes: of the same address first.

    So nobody keeps others from being heard, not even those of his own address. Lives on one event loop.
    """

    def __init__(self, within_s: float = WITHIN_S) -> None:
        self._within_s = within_s
        self._all: OrderedDict[AwaitedRequest, None] = OrderedDict()
        self._of_address: defaultdict[str, OrderedDict[AwaitedRequest, None]] = defaultdict(OrderedDict)

    async def only(
        self, context: Context, most_bytes: int | None = SMALL_REQUEST_BYTES, arrive: Arrive | None = None
    ) -> bytes:
        """The request of a call. Raises StreamRefused where it does not come in time, is too long, or not the only one.

        most_bytes: that it may have; None: as many as the port lets through. arrive: where it counts; None: nowhere.
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
    """Of a task that goes on when nobody waits for it any more: else asyncio logs how it failed."""
    if not done.cancelled():
        done.exception()


def parsed_as(kind: type[M], request: bytes) -> M:
    """Raises StreamRefused for what is no message of that kind."""
    try:
        return kind.FromString(request)
    except DecodeError as error:
        raise malformed(str(error)) from error
