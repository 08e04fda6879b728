"""Elsewhere: streams to other servers, for sessions for which the client's own has no free capacity."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Collection

from motiongen_client.errors import EventRefused, MotiongenError, OtherServer
from motiongen_client.session import Session
from motiongen_client.stream import Stream
from motiongen_client.types import as_tuple, check_text

_log = logging.getLogger(__name__)

MOST_WAYS = 64
"""Limit on the streams remembered by address or key; keys change, and several may lead to one server."""
MOST_ASKED = 4
"""Limit on the servers asked for one session, including the first."""


class Elsewhere:
    """Made by `MotionClient`, whose own stream is asked first. is_allowed: whether the client may use an address."""

    def __init__(
        self,
        make_stream: Callable[[str, str], Stream],
        other_addresses: Collection[str] | Callable[[str], bool],
        *,
        takes_keys: bool = True,
    ) -> None:
        """make_stream: makes a stream to an address and with a routing key, each "" for the client's own.

        takes_keys: whether calls may carry another key than the client's; not if the application chose that one.
        """
        self._make_stream = make_stream
        self._takes_keys = takes_keys
        self.is_allowed = other_addresses if callable(other_addresses) else _among(other_addresses)
        self._streams: dict[OtherServer, asyncio.Task[Stream]] = {}
        self._moving: set[asyncio.Task[None]] = set()

    async def open(self, stream: Stream, open_on: Callable[[Stream], Awaitable[Session]]) -> Session:
        """Open a session on a stream, or on a server that its refusal names. Raises the last refusal."""
        asked = {stream.replica_id}
        while True:
            try:
                return await open_on(stream)
            except EventRefused as refusal:
                following = await self._next(refusal, asked)
                if following is None:
                    raise
                stream = following

    def move(self, stream: Stream, session: Session, refusal: EventRefused) -> bool:
        """Have another server continue a session that waits. Returns False if none is known that may be asked."""
        if not any(self._way(each) for each in refusal.other_servers):
            return False
        task = asyncio.get_running_loop().create_task(self._move(stream, session, refusal), name="motiongen-move")
        self._moving.add(task)
        task.add_done_callback(self._moving.discard)
        return True

    async def _move(self, stream: Stream, session: Session, refusal: EventRefused) -> None:
        call = stream.call_number
        session.asked.add(stream.replica_id)  # full servers that name each other would be asked in turn without end
        try:
            following = await self._next(refusal, session.asked)
        except Exception as fault:  # of the token function, whose own network may be down too
            _log.warning("session %d cannot go on at another server: %s", session.handle, fault)
            following = None
        if not session.is_waiting or stream.call_number != call:
            return  # it has ended, or its own server has been asked again
        if following is None or following.is_over:
            session.wait_for_room(refusal)
            return
        _log.info("session %d goes on at another server: %s", session.handle, refusal.reason)
        stream.release(session)
        following.adopt(session)

    async def _next(self, refusal: EventRefused, asked: set[str]) -> Stream | None:
        """A stream, with a call, to a server that a refusal names and that was not asked yet; None if there is none.

        The stream must have a call. If its call was ended because it carried no session, or its server is gone, a
        session would wait there without end while another server, or its own, might accept it.
        """
        if len(asked) >= MOST_ASKED:
            return None
        for server in refusal.other_servers:
            way = self._way(server)
            if way is None:
                continue
            try:
                stream = await self._stream(way)
                await stream.ready()
            except MotiongenError as error:
                _log.info("a server that was named cannot be reached: %s", error)
                continue
            if stream.replica_id not in asked:  # if asked, no proxy routes by the key
                asked.add(stream.replica_id)
                return stream
        return None

    def _way(self, server: OtherServer) -> OtherServer | None:
        """How to reach a server: by its own address if that is allowed, else by its key; None if neither works."""
        if server.address and self.is_allowed(server.address):
            return OtherServer(address=server.address)
        return OtherServer(routing_key=server.routing_key) if server.routing_key and self._takes_keys else None

    async def _stream(self, way: OtherServer) -> Stream:
        """Raises ServerUnavailable, StreamLost or InvalidInput."""
        begun = self._streams.get(way)
        if begun is None or (begun.done() and (_failed(begun) or begun.result().is_over)):
            for old in list(self._streams)[: max(0, len(self._streams) + 1 - MOST_WAYS)]:
                del self._streams[old]  # the stream itself continues while it carries sessions
            begun = asyncio.get_running_loop().create_task(self._begin(way), name="motiongen-elsewhere")
            self._streams[way] = begun
        return await asyncio.shield(begun)

    async def _begin(self, way: OtherServer) -> Stream:
        stream = self._make_stream(way.address, way.routing_key)
        await stream.start()
        for other in [each.result() for each in self._streams.values() if each.done() and not _failed(each)]:
            if other.replica_id == stream.replica_id and other.is_connected:  # the same server, reached in another way
                await stream.close()
                return other
        try:
            await stream.ask_catalog()
        except BaseException:
            await stream.close()
            raise
        return stream

    async def close(self) -> None:
        """Stop moving sessions. The client closes the streams."""
        tasks = [*self._moving, *self._streams.values()]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        self._streams.clear()


def _among(addresses: Collection[str]) -> Callable[[str], bool]:
    """Raises InvalidInput for anything but addresses; the signs of a single one would be taken for several."""
    allowed = "several addresses, such as ['host:50051'], or a function that says whether one is allowed"
    given = as_tuple("other_addresses", addresses, allowed)
    for each in given:
        check_text("other_addresses", each, allowed)
    return frozenset(given).__contains__


def _failed(task: asyncio.Task[Stream]) -> bool:
    return task.cancelled() or task.exception() is not None
