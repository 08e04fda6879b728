"""Requests: the one request of each call that takes one, awaited for a while, and for so many calls at once.

gRPC would wait for ever: it begins a call when its headers have come, and a client may send nothing else. So methods of
one request are served as streams of requests, of which there has to be one; on the wire that is the same.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import OrderedDict, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

import grpc.aio
from google.protobuf.message import DecodeError, Message

from motiongen_server.rpc.call_errors import one_request_expected, request_late
from motiongen_server.rpc.peers import address_of
from motiongen_server.rpc.stream_errors import malformed

M = TypeVar("M", bound=Message)
Context: TypeAlias = "grpc.aio.ServicerContext[Any, Any]"
WITHIN_S = 5.0
"""A client of gRPC sends the request with the headers: it is there at once, or its client is none."""
MOST_WAITING = 512
MOST_WAITING_OF_AN_ADDRESS = 128


@dataclass(eq=False, slots=True)
class _Waiting:
    """over: set once the call is not waited for any longer."""

    over: asyncio.Future[None]
    since: float

    def end(self) -> None:
        if not self.over.done():
            self.over.set_result(None)


class Requests:
    """Of the calls of a port. Where too many wait, the one that has waited longest goes: of the same address first.

    So nobody keeps others from being heard, not even those of his own address. Lives on one event loop.
    """

    def __init__(self, within_s: float = WITHIN_S) -> None:
        self._within_s = within_s
        self._all: OrderedDict[_Waiting, None] = OrderedDict()
        self._of_address: defaultdict[str, OrderedDict[_Waiting, None]] = defaultdict(OrderedDict)

    async def only(self, context: Context) -> bytes:
        """The request of a call. Raises StreamRefused where it does not come in time, or is not the only one."""
        reading = asyncio.ensure_future(_only(context))
        reading.add_done_callback(look_at)
        with self._waiting(address_of(context.peer())) as waiting:
            # What is read is never cancelled, since gRPC would lose it: a call that is ended ends its reading.
            either: set[asyncio.Future[Any]] = {reading, waiting.over}
            await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
            if not reading.done():
                raise request_late(time.monotonic() - waiting.since)
        return reading.result()

    @contextlib.contextmanager
    def _waiting(self, address: str) -> Iterator[_Waiting]:
        loop, of_address = asyncio.get_running_loop(), self._of_address[address]
        if len(of_address) >= MOST_WAITING_OF_AN_ADDRESS:
            _oldest(of_address).end()
        elif len(self._all) >= MOST_WAITING:
            _oldest(self._all).end()
        waiting = _Waiting(loop.create_future(), time.monotonic())
        self._all[waiting] = of_address[waiting] = None
        timer = loop.call_later(self._within_s, waiting.end)
        try:
            yield waiting
        finally:
            timer.cancel()
            del self._all[waiting], of_address[waiting]
            if not of_address:
                self._of_address.pop(address, None)


def _oldest(waiting: OrderedDict[_Waiting, None]) -> _Waiting:
    return next((each for each in waiting if not each.over.done()), next(iter(waiting)))


async def _only(context: Context) -> bytes:
    request = await context.read()
    if not isinstance(request, bytes):  # grpc.aio.EOF
        raise one_request_expected("none")
    if await context.read() is not grpc.aio.EOF:
        raise one_request_expected("more than one")
    return request


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
