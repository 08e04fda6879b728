"""StreamTakeOvers: takes over sessions of other servers for a stream, and holds their events back meanwhile."""

from __future__ import annotations

import asyncio
import time
from abc import abstractmethod
from collections import deque
from dataclasses import dataclass, field
from functools import partial

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import Outcome, SessionKey
from motiongen_server.engine.types.refusals import draining, too_many_pending
from motiongen_server.errors import EventRefused
from motiongen_server.models.registry import ModelRegistry
from motiongen_server.rpc.budgets.loop_time import Work
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.budgets.stream_budget import FREE, REFUSAL_COST, RESUME_COST, StreamBudget
from motiongen_server.rpc.sessions.durability import Durability
from motiongen_server.rpc.sessions.event_path import MAX_WAITING_EVENTS
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from motiongen_server.rpc.sessions.taking_over import NoRoom, adopted, claimed
from motiongen_server.rpc.stream_metrics import StreamMetrics
from motiongen_server.rpc.streams.sessions import StreamSessions
from motiongen_server.snapshots.record import SessionRecord
from motiongen_server.text.turns import Asker

LOOK_AGAIN_S = 1.0
"""A waiting stream looks this often whether it still owes: the clients that used up everything may be gone."""


@dataclass(slots=True)
class _HeldBack:
    """Events for a session that is being taken over, in order. num_bytes: of its OpenSession and these events.

    task: takes the session over, then these events.
    """

    task: asyncio.Task[None] | None = None
    num_bytes: int = 0
    events: deque[tuple[session_pb2.SessionEvent, float, EventRefused | None]] = field(default_factory=deque)


class StreamTakeOvers(StreamSessions):
    """The part of a `Stream` that waits for the store of snapshots. The stream's other sessions do not wait.

    Meanwhile the session's events are held back, in order. accepts_opens: False once the server is going away.
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
        self.peer = peer
        self.budget = StreamBudget(models.limits.stream_events_per_second, peer, now)
        work = Work(peer.loop, lambda seconds: self.budget.charge_loop(seconds, time.monotonic()))
        super().__init__(number, models.limits, stream_metrics, kept, work)
        self.accepts_opens = True
        self._models = models
        self._held_back: dict[int, _HeldBack] = {}
        self._taking_over: set[asyncio.Task[None]] = set()

    @property
    def num_waiting_bytes(self) -> int:
        """Roughly the bytes that wait to be written, are kept to be sent again, or have come and wait for anything."""
        held_back = sum(each.num_bytes for each in self._held_back.values())
        return super().num_waiting_bytes + held_back + self.peer.held.of(self)

    @property
    def peer_name(self) -> str:
        """The peer that the stream counts for."""
        return self.peer.name

    @abstractmethod
    def fail(self, error: Exception) -> None:
        """End the stream because of a fault of the server's own."""

    def owed_s(self, now: float) -> float:
        """Seconds until more of the stream may be read."""
        return self.budget.owed_s(now)

    async def turn(self) -> None:
        """Let other streams have a turn in the middle of a message, then wait as `room` does."""
        await asyncio.sleep(0)
        await self.room()

    async def room(self) -> None:
        """Wait until more of the stream may be read, or it ends.

        It is not read while it owes for what it has sent, nor while too many answers wait for its client to read.
        gRPC's flow control passes the back-pressure on to the client.
        """
        is_held = False
        while not self.ended:
            owed_s = self.owed_s(now := time.monotonic())
            if not owed_s and not self._is_backlogged:
                return
            if not is_held and self.budget.loop_owed_s(now):
                is_held = True
                self.peer.loop.num_held += 1
            self._room.clear()
            look_s = min(owed_s, LOOK_AGAIN_S)
            timer = asyncio.get_running_loop().call_later(look_s, self._room.set) if owed_s else None
            await self._room.wait()
            if timer is not None:
                timer.cancel()

    @abstractmethod
    def _receive(self, event: session_pb2.SessionEvent, now: float, unread: EventRefused | None) -> None:
        """Take one event of a session that is not being taken over."""

    def _begin_take_over(self, event: session_pb2.SessionEvent, durability: Durability, now: float) -> None:
        """Begin to take over a session that another server holds, or held; it continues here once the store answers.

        The event may be one that was held back; the events behind it then stay held back for the new session. Raises
        EventRefused if the peer has too much waiting.
        """
        num_bytes = event.open.ByteSize()
        self.peer.check_waiting(num_bytes)
        # Before the store is asked: anybody can make up tokens, and only the store knows them.
        self.budget.charge(RESUME_COST, now)
        opening = session_pb2.OpenSession()
        opening.CopyFrom(event.open)  # otherwise the whole message would stay in memory with it
        held_back = self._held_back.setdefault(event.session, _HeldBack())
        self._count(held_back, num_bytes)
        task = held_back.task = asyncio.get_running_loop().create_task(
            self.work.of(partial(self._take_over, event.session, opening, durability, now))
        )
        self._taking_over.add(task)
        task.add_done_callback(self._taking_over.discard)

    async def taken_over(self, writer: asyncio.Task[None]) -> None:
        """Wait until no session is being taken over, or the writer ends: a client that has finished is owed answers."""
        while self._taking_over and not writer.done():
            await asyncio.wait({writer, *self._taking_over}, return_when=asyncio.FIRST_COMPLETED)

    async def _take_over(
        self, handle: int, opening: session_pb2.OpenSession, durability: Durability, now: float
    ) -> None:
        """Take a session over, then the events that its client has sent meanwhile."""
        key = SessionKey(self.number, handle)
        try:
            if not self.accepts_opens:
                raise draining()
            asker = Asker(self.peer.name, self.number)
            token, record = await claimed(durability, opening, self.peer, self._models, asker)
            if not self.ended:  # otherwise its client has gone, and will come back, here or elsewhere
                self._adopt(record, token, opening, key, durability, now)
        except NoRoom as error:
            self._refuse_take_over(error.refusal, self._hinted(error.refusal.outcome(key, 1), error.model.model_id))
        except EventRefused as refusal:
            self._refuse_take_over(refusal, refusal.outcome(key, 1))
        except Exception as error:
            self.fail(error)
        finally:
            await self._go_through(handle)

    def _refuse_take_over(self, refusal: EventRefused, told: Outcome) -> None:
        self._stream_metrics.count_resume("refused")
        self.work.num_events += 1
        self.work.num_refused += refusal.code not in FREE
        self._say(told, None)

    async def _go_through(self, handle: int) -> None:
        """Take the events that were held back, as the stream can pay for them; new ones are held back behind them.

        Stops once the stream has ended: a session opened then would have no client, and clients send the events again.
        """
        held_back, task = self._held_back[handle], asyncio.current_task()
        try:
            while held_back.events and held_back.task is task:  # else the handle's next session is being taken over
                await self.turn()
                if self.ended:
                    break
                event, received_at, unread = held_back.events.popleft()
                self._count(held_back, -event.ByteSize())
                with self.work:
                    self._receive(event, received_at, unread)
        except Exception as error:
            self.fail(error)
        finally:
            if held_back.task is task:
                self._count(held_back, -held_back.num_bytes)
                del self._held_back[handle]

    def _count(self, held_back: _HeldBack, num_bytes: int) -> None:
        held_back.num_bytes += num_bytes
        self.peer.waiting_bytes += num_bytes

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
        """Keep an event until the take-over of its session has ended, and the events before it were taken."""
        held_back, handle, num_bytes = self._held_back[event.session], event.session, event.ByteSize()
        if event.WhichOneof("event") == "playhead":  # it describes the present
            if handle in self._entries:
                self._receive(event, now, unread)
            return
        try:
            if len(held_back.events) >= MAX_WAITING_EVENTS:
                raise too_many_pending("events", MAX_WAITING_EVENTS)
            self.peer.check_waiting(num_bytes)
        except EventRefused as refusal:
            self.budget.charge(REFUSAL_COST, now)
            self._say(refusal.outcome(SessionKey(self.number, handle), event.event_seq), None)
            return
        kept = session_pb2.SessionEvent()
        kept.CopyFrom(event)  # otherwise the whole message would stay in memory with it
        held_back.events.append((kept, now, unread))
        self._count(held_back, num_bytes)
