"""One stream that carries hundreds of characters: what it sends, and how it handles what it receives."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterable
from typing import Any

import grpc
import grpc.aio

from motiongen.v1 import service_pb2, session_pb2
from motiongen.v1.service_pb2_grpc import MotionServiceStub
from motiongen_client.convert import code_name
from motiongen_client.errors import ServerUnavailable
from motiongen_tools.bench.character import Character
from motiongen_tools.bench.recorder import GENERATOR, WRITE_WAIT, Recorder
from motiongen_tools.connection import PLAIN, Connection

_CHANNEL_OPTIONS = (
    ("grpc.use_local_subchannel_pool", 1),  # a connection per stream, as with separate clients
    ("grpc.max_receive_message_length", 64 << 20),
    ("grpc.http2.bdp_probe", 0),
    ("grpc.http2.lookahead_bytes", 1 << 20),
    ("grpc.enable_retries", 0),
)
_CONNECT_TIMEOUT_S = 3.0
_HELLO_TIMEOUT_S = 15.0
_CLOSE_GRACE_S = 5.0
_EVENT_OVERHEAD_BYTES = 8
_CLIENT = session_pb2.CLOSE_REASON_CLIENT


class StreamClient:
    """One call. Made before the run, so that connecting is not measured.

    clock: seconds from the start of the run. Refusals are counted in `recorder`; they are not failures.
    """

    def __init__(
        self,
        address: str,
        max_request_bytes: int,
        clock: Callable[[], float],
        recorder: Recorder,
        connection: Connection = PLAIN,
        note_round_trip: Callable[[float, float], None] = lambda now_s, seconds: None,
    ) -> None:
        """note_round_trip: called for each pong, with its arrival time and the round trip."""
        self._address = address
        self._connection = connection
        self._max_bytes = max_request_bytes * 9 // 10
        self._clock = clock
        self._recorder = recorder
        self._characters: dict[int, Character] = {}
        self._groups: dict[int, str] = {}
        self._queue: list[tuple[float, service_pb2.StreamMotionRequest]] = []
        self._filling: service_pb2.StreamMotionRequest | None = None
        self._filling_bytes = 0
        self._filled = asyncio.Event()
        self._greeted = asyncio.Event()
        self._ending = False
        self._note_round_trip = note_round_trip
        self._round_trip_s: float | None = None
        self.lost = ""

    def adopt(self, characters: Iterable[tuple[Character, str]]) -> None:
        """Set the characters of this stream, each with the name of its group."""
        for character, group in characters:
            self._characters[character.handle] = character
            self._groups[character.handle] = group

    @property
    def characters(self) -> Iterable[Character]:
        return self._characters.values()

    async def start(self) -> None:
        """Connect and exchange hellos. Raises ServerUnavailable."""
        self._channel = self._connection.channel(self._address, _CHANNEL_OPTIONS)
        with contextlib.suppress(TimeoutError):  # on a timeout, the call's status says why
            await asyncio.wait_for(self._channel.channel_ready(), _CONNECT_TIMEOUT_S)
        self._call = MotionServiceStub(self._channel).StreamMotion(metadata=self._connection.metadata())
        self._reading = asyncio.create_task(self._read(), name="bench-read")
        # Awaited before anything is written: cancelling a call does not end a write that waits for a connection.
        self._connecting = asyncio.create_task(self._call.wait_for_connection(), name="bench-connect")
        self._writing = asyncio.create_task(self._write(), name="bench-write")
        greeted = asyncio.create_task(self._greeted.wait(), name="bench-hello")
        await asyncio.wait({self._reading, greeted}, timeout=_HELLO_TIMEOUT_S, return_when=asyncio.FIRST_COMPLETED)
        greeted.cancel()
        if not self._greeted.is_set():
            why = self.lost or f"no hello came within {_HELLO_TIMEOUT_S:g} s"
            await self.stop()
            raise ServerUnavailable(self._address, why)

    async def stop(self) -> None:
        """End the call. The server closes its sessions."""
        self._ending = True
        self._filled.set()
        if self._greeted.is_set():
            await asyncio.wait({self._reading, self._writing}, timeout=_CLOSE_GRACE_S)
        self._call.cancel()
        self._connecting.cancel()
        await asyncio.gather(self._reading, self._writing, return_exceptions=True)
        await self._channel.close(None)

    # ---- out

    def put(self, event: session_pb2.SessionEvent) -> None:
        """Queue an event for the next `flush`."""
        num_bytes = event.ByteSize() + _EVENT_OVERHEAD_BYTES
        if self._filling is None or self._filling_bytes + num_bytes > self._max_bytes:
            self._begin_request()
        assert self._filling is not None
        self._filling.events.append(event)
        self._filling_bytes += num_bytes

    def put_ping(self) -> None:
        """Send a ping, with the last round trip."""
        self._begin_request()
        assert self._filling is not None
        ping = self._filling.ping
        ping.client_time_ns = int(self._clock() * 1e9)
        if self._round_trip_s is not None:
            ping.round_trip.FromNanoseconds(int(self._round_trip_s * 1e9))

    def flush(self) -> None:
        """Hand what is queued to the write loop."""
        if self._filling is not None:
            self._filling = None
            self._filled.set()

    def _begin_request(self) -> None:
        self._filling = service_pb2.StreamMotionRequest()
        self._filling_bytes = 0
        self._queue.append((self._clock(), self._filling))

    async def _write(self) -> None:
        hello = service_pb2.ClientHello(client_agent="motiongen-bench")
        with contextlib.suppress(grpc.aio.AioRpcError, asyncio.InvalidStateError, asyncio.CancelledError):
            await self._connecting
            await self._call.write(service_pb2.StreamMotionRequest(hello=hello))
            while not self.lost:
                await self._filled.wait()
                self._filled.clear()
                while self._queue and self._queue[0][1] is not self._filling and not self.lost:
                    queued_s, request = self._queue.pop(0)
                    self._recorder.record(WRITE_WAIT, GENERATOR, self._clock() - queued_s)
                    await self._call.write(request)
                if self._ending:
                    await self._call.done_writing()
                    return

    # ---- in

    async def _read(self) -> None:
        try:
            while isinstance(response := await self._call.read(), service_pb2.StreamMotionResponse):
                self._take(response)
            self.lost = self.lost or "the server ended the stream"
        except grpc.aio.AioRpcError as error:
            self.lost = f"{error.code().name}, {error.details()}"
        except asyncio.CancelledError:
            self.lost = "cancelled"
        if not self._ending:
            self._lose()
        self._filled.set()

    def _lose(self) -> None:
        now_s = self._clock()
        self._recorder.counts["streams_lost"] += 1
        self._recorder.counts[f"stream_lost: {self.lost}"] += 1
        for character in self._characters.values():
            if character.is_live:
                self._recorder.counts["sessions_lost: STREAM_LOST"] += 1
                character.end(now_s, as_planned=False)

    def _take(self, response: service_pb2.StreamMotionResponse) -> None:
        now_s = self._clock()
        counts = self._recorder.counts
        counts["messages_received"] += 1
        counts["updates_received"] += len(response.updates)
        match response.WhichOneof("stream_event"):
            case "hello":
                self._greeted.set()
            case "pong":
                self._round_trip_s = now_s - response.pong.client_time_ns / 1e9
                self._note_round_trip(now_s, self._round_trip_s)
            case "goodbye":
                counts["goodbyes"] += 1
        for update in response.updates:
            character = self._characters.get(update.session)
            if character is None or character.ended:
                continue  # sent before the server knew that it had ended
            kind = update.WhichOneof("update")
            if kind == "chunk":
                started = character.started
                character.take_chunk(update.chunk, now_s)
                if not started:
                    self.put(report(character, now_s))  # starts the server's clock for it
                    self.flush()
            elif kind == "plan":
                character.take_notice(update.plan, now_s)
            elif kind == "outcome":
                self._take_outcome(character, update.outcome, now_s)
            elif kind == "opened":
                character.take_opened()
                counts["sessions_opened"] += 1
            elif kind == "service_level":
                level = update.service_level
                tier = _short_name(session_pb2.ServiceTier.Name, level.tier, "SERVICE_TIER_")
                counts[f"service level: {tier}, {level.denoise_steps} steps"] += 1
            elif kind == "closed":
                self._take_closed(character, update.closed, now_s)

    def _take_outcome(self, character: Character, outcome: session_pb2.EditOutcome, now_s: float) -> None:
        is_open = outcome.event_seq == 1
        if outcome.code:
            kind = "open" if is_open else "edit"
            self._recorder.counts[f"refused {kind}: {outcome.reason or code_name(outcome.code)}"] += 1
            self._recorder.add("refused", self._groups[character.handle], now_s)
            if is_open:
                character.refused()
                return
        character.take_outcome(outcome, now_s)

    def _take_closed(self, character: Character, closed: session_pb2.SessionClosed, now_s: float) -> None:
        self._recorder.counts["frames_late_by_server"] += closed.late_frames
        if closed.reason != _CLIENT:
            name = _short_name(session_pb2.CloseReason.Name, closed.reason, "CLOSE_REASON_")
            self._recorder.counts[f"sessions_lost: {name}"] += 1
            character.end(now_s, as_planned=False)


def _short_name(name_of: Callable[[Any], str], number: int, prefix: str) -> str:
    """The name of an enum value without the common prefix; for a value that a later version added, its number."""
    try:
        return name_of(number).removeprefix(prefix)
    except ValueError:
        return str(number)


def report(character: Character, now_s: float) -> session_pb2.SessionEvent:
    """A playhead: the frame shown, the frames held, and for how many frame times a pose was held."""
    playhead = session_pb2.Playhead(
        frame=character.playhead(now_s),
        buffered_to=character.buffered_to,
        underruns=character.missed + character.held_now(now_s),
    )
    return session_pb2.SessionEvent(session=character.handle, playhead=playhead)
