"""StreamTakeOvers: the sessions that other servers held, on their way to a stream."""

from __future__ import annotations

import asyncio
from abc import abstractmethod

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import SessionKey
from motiongen_server.engine.types.refusals import draining, too_many_pending
from motiongen_server.errors import EventRefused
from motiongen_server.models.registry import ModelRegistry
from motiongen_server.rpc.budget import REFUSAL_COST, StreamBudget
from motiongen_server.rpc.durability import Durability
from motiongen_server.rpc.event_path import MAX_WAITING_EVENTS
from motiongen_server.rpc.kept_sessions import KeptSessions
from motiongen_server.rpc.peers import Peer
from motiongen_server.rpc.stream_metrics import StreamMetrics
from motiongen_server.rpc.stream_sessions import StreamSessions
from motiongen_server.rpc.taking_over import adopted, claimed
from motiongen_server.snapshots.record import SessionRecord


class StreamTakeOvers(StreamSessions):
    """The part of a `Stream` that waits for the store of snapshots. The stream's other sessions do not wait.

    What a client says of a session meanwhile is kept, in order. accepts_opens: False once the server goes away.
    """

    def __init__(
        self,
        number: int,
        models: ModelRegistry,
        stream_metrics: StreamMetrics,
        kept: KeptSessions,
        peer: Peer,
        now: float,
    ) -> None:
        super().__init__(number, models.limits, stream_metrics, kept)
        self.peer = peer
        self.budget = StreamBudget(models.limits.stream_events_per_second, peer, now)
        self.accepts_opens = True
        self._models = models
        self._held_back: dict[int, list[tuple[session_pb2.SessionEvent, float, EventRefused | None]]] = {}
        self._taking_over: set[asyncio.Task[None]] = set()

    @abstractmethod
    def receive(self, event: session_pb2.SessionEvent, now: float, unread: EventRefused | None = None) -> None:
        """Take one event of the client."""

    def _begin_take_over(self, event: session_pb2.SessionEvent, durability: Durability, now: float) -> None:
        """Go on with a session that another server holds, or held, as soon as the store has told of it."""
        opening = session_pb2.OpenSession()
        opening.CopyFrom(event.open)  # else the whole message would be kept with it
        self._held_back[event.session] = []
        task = asyncio.get_running_loop().create_task(self._take_over(event.session, opening, durability, now))
        self._taking_over.add(task)
        task.add_done_callback(self._taking_over.discard)

    async def taken_over(self, writer: asyncio.Task[None]) -> None:
        """Wait, as long as there is a writer, until no session is on its way: who has finished is owed its answer."""
        while self._taking_over and not writer.done():
            await asyncio.wait({writer, *self._taking_over}, return_when=asyncio.FIRST_COMPLETED)

    async def _take_over(
        self, handle: int, opening: session_pb2.OpenSession, durability: Durability, now: float
    ) -> None:
        """Take a session over, then what its client has said meanwhile."""
        key = SessionKey(self.number, handle)
        try:
            if not self.accepts_opens:
                raise draining()
            token, record = await claimed(durability, opening, self.peer, self._models)
            if not self.ended:  # else its client has gone, and will come again, here or elsewhere
                self._adopt(record, token, opening, key, durability, now)
        except EventRefused as refusal:
            self._stream_metrics.count_resume("refused")
            self.budget.charge(REFUSAL_COST, now)
            self._say(refusal.outcome(key, 1), None)
        finally:
            held_back = self._held_back.pop(handle)
        for event, received_at, unread in held_back:
            self.receive(event, received_at, unread)

    def _adopt(
        self,
        record: SessionRecord,
        token: str,
        opening: session_pb2.OpenSession,
        key: SessionKey,
        durability: Durability,
        now: float,
    ) -> None:
        rate = self._limits.events_per_second
        entry, event = adopted(
            record,
            token,
            opening,
            key,
            models=self._models,
            peer=self.peer,
            carrier=self,
            events_per_second=rate,
            now=now,
        )
        self._entries[key.handle] = self._by_key[key] = entry
        self._kept.add(entry)
        durability.adopt(entry)
        self._stream_metrics.count_resume("taken_over")
        refusal = entry.model.engine.submit(event)
        if refusal is not None:
            self.take_now(refusal)

    def _hold_back(self, event: session_pb2.SessionEvent, now: float, unread: EventRefused | None) -> None:
        """Keep an event until its session is there, or is not."""
        waiting = self._held_back[event.session]
        if event.WhichOneof("event") == "playhead":
            return
        if len(waiting) >= MAX_WAITING_EVENTS:
            self.budget.charge(REFUSAL_COST, now)
            refusal = too_many_pending("events", MAX_WAITING_EVENTS)
            self._say(refusal.outcome(SessionKey(self.number, event.session), event.event_seq), None)
            return
        kept = session_pb2.SessionEvent()
        kept.CopyFrom(event)  # else the whole message would be kept with it
        waiting.append((kept, now, unread))
