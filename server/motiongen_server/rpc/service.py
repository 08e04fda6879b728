"""The servicer: runs a read loop and a write loop for each stream, and the other calls. It makes no decisions."""

from __future__ import annotations

import asyncio
import itertools
import logging
import secrets
import time
from collections import defaultdict
from collections.abc import AsyncIterator, Sequence
from functools import partial

from motiongen.v1 import service_pb2
from motiongen_server.engine.types import CloseReason, Output
from motiongen_server.errors import StreamRefused
from motiongen_server.identity.caller import Caller
from motiongen_server.identity.callers import Callers
from motiongen_server.models.registry import LoadedModel, ModelRegistry
from motiongen_server.replicas.other_servers import OtherServers
from motiongen_server.rpc.budgets.gateway_lag import GatewayLag
from motiongen_server.rpc.budgets.loop_time import CLOCKS, Clocks, LoopTime
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.budgets.peers import Peers
from motiongen_server.rpc.budgets.waiting_memory import WaitingMemory
from motiongen_server.rpc.calls.admission import CallAdmission
from motiongen_server.rpc.calls.context import CallContext, refuse
from motiongen_server.rpc.calls.requests import parsed_as
from motiongen_server.rpc.calls.work import begin_work, work_for
from motiongen_server.rpc.clip import ClipService, clip_request
from motiongen_server.rpc.errors.streams import stream_failed, too_many_streams
from motiongen_server.rpc.handlers import StreamContext
from motiongen_server.rpc.limits import OTHER_CALLS, ServiceLimits
from motiongen_server.rpc.sessions.durability import Durability
from motiongen_server.rpc.sessions.entry import Carrier
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from motiongen_server.rpc.stream_metrics import NoStreamMetrics, StreamMetrics
from motiongen_server.rpc.streams.goodbye import say_draining
from motiongen_server.rpc.streams.reader import StreamReader
from motiongen_server.rpc.streams.stream import Stream
from motiongen_server.rpc.streams.tracing import RecordWindow, StreamTracing
from motiongen_server.rpc.streams.watch import StreamWatch
from motiongen_server.rpc.streams.writer import cut, write
from motiongen_server.snapshots.store import SnapshotStore

_log = logging.getLogger(__name__)


class MotionService:
    """Carries events from streams to the engine and outputs back. Lives on one event loop."""

    def __init__(
        self,
        models: ModelRegistry,
        flush_s: float = 0.02,
        *,
        stream_metrics: StreamMetrics | None = None,
        limits: ServiceLimits | None = None,
        callers: Callers | None = None,
        snapshots: SnapshotStore | None = None,
        record_window: RecordWindow | None = None,
        other_servers: OtherServers | None = None,
        clocks: Clocks = CLOCKS,
    ) -> None:
        """callers: who may call; by default everybody. snapshots: where sessions are saved; None: nowhere.

        record_window: takes the traces of windows; None: there are none. other_servers: of the same store, named to
        clients that are refused for lack of room; None: none are known. clocks: measure the event loop time that
        messages take.
        """
        self._models = models
        self._callers = callers or Callers()
        self._limits = limits or ServiceLimits()
        self._loop_time = LoopTime(self._limits.loop_share, time.monotonic(), clocks)
        self._flush_s = flush_s
        self._stream_metrics = stream_metrics
        self._record_window = record_window
        self._others = other_servers
        self._reader = StreamReader(models, secrets.token_hex(4), self._limits.reconnect_after_s)
        self._numbers = itertools.count(1)
        self._loop = asyncio.get_running_loop()
        count = (stream_metrics or NoStreamMetrics()).count_snapshot
        self.durability = None if snapshots is None else Durability(snapshots, self._loop, count)
        self._kept = KeptSessions(models.limits.resume_grace_s, stream_metrics, self.durability)
        self._streams: dict[int, Stream] = {}
        self._memory = WaitingMemory(self._limits.max_waiting_bytes, self._streams, self._kept)
        peers = Peers(self._limits.peer, self._loop_time, models.note_owner)
        most_calls = self._limits.max_clip_calls + OTHER_CALLS
        self._admission = CallAdmission(self._callers, peers, most_calls, memory=self._memory)
        self.clips = ClipService(models, self._numbers, stream_metrics, self._limits, self._memory)
        self.watch = StreamWatch(self._limits, self._streams, self._callers, self._memory, self._admission.renew_quotas)
        self._lag = GatewayLag(lambda: bool(self._streams))
        models.is_gateway_full = lambda: self._lag.is_too_long
        self._all_ended = asyncio.Event()
        self._all_ended.set()
        if other_servers is not None:
            other_servers.start(lambda: models.free_shares)

    @property
    def num_streams(self) -> int:
        return len(self._streams)

    @property
    def num_parked(self) -> int:
        """Sessions that wait for a client that has lost its connection."""
        return self._kept.num_parked

    @property
    def num_other_servers(self) -> int:
        """Servers of the same store that can be named to clients that find no room here."""
        return 0 if self._others is None else self._others.num_known

    @property
    def gateway_lag_s(self) -> float:
        """How long messages to be read or written wait for the event loop."""
        return self._lag.lag_s

    @property
    def loop_taken_s(self) -> float:
        """The event loop time that clients' messages have taken so far, in seconds."""
        return self._loop_time.taken_s

    @property
    def num_held_back(self) -> int:
        """How often the next read of a stream waited because of the event loop time that it had taken."""
        return self._loop_time.num_held

    @property
    def num_waiting_bytes(self) -> int:
        """Bytes held for all streams, clips and parked sessions: to be written, to be sent again, or that have come."""
        return self._memory.num_bytes

    # ---- from the engine's thread -----------------------------------------------------------------------------------

    def deliver(self, outputs: Sequence[Output]) -> None:
        """Take the outputs of one engine step, on the engine's thread; the event loop sends them."""
        try:
            self._loop.call_soon_threadsafe(self._dispatch, tuple(outputs))
        except RuntimeError:  # the loop has been closed: the process is on its way out
            _log.debug("outputs after the event loop's end")

    def _dispatch(self, outputs: tuple[Output, ...]) -> None:
        by_carrier: defaultdict[int | Carrier, list[Output]] = defaultdict(list)
        carrier_of = self._kept.carrier_of if self._kept.has_away else None
        for output in outputs:
            carrier = None if carrier_of is None else carrier_of(output.session)
            by_carrier[output.session.stream if carrier is None else carrier].append(output)
        for of, said in by_carrier.items():
            found: Carrier | None = self._streams.get(of) if isinstance(of, int) else of
            if found is not None:
                try:
                    found.take(*said)
                except Exception as error:  # outputs for the others must not be lost with it
                    found.fail(error)
            elif isinstance(of, int):  # a clip's, or of a client that has gone
                self.clips.take(of, said)

    # ---- calls ------------------------------------------------------------------------------------------------------

    async def GetCatalog(self, call: CallContext) -> service_pb2.GetCatalogResponse:
        """Rigs, models and limits, or only the etag for a client that has them already. Raises StreamRefused."""
        _, data = await self._admission.request(call)
        self._note_call(call)
        return self._models.catalog_response(parsed_as(service_pb2.GetCatalogRequest, data).catalog_etag)

    async def GenerateClip(self, call: CallContext) -> None:
        """Samples of one clip, from the request to the last frame. Raises StreamRefused."""
        peer, data = await self._admission.request(call, most_bytes=None)
        self._note_call(call)
        call.hold(begin_work(peer))
        with work_for(peer):
            request = clip_request(data, self._models.limits.max_event_fields)
        del data  # otherwise it would be held as long as the call lasts
        await self.clips.generate(request, call, peer)

    def _note_call(self, context: StreamContext | CallContext) -> None:
        if self._others is not None:
            self._others.note_call(context.invocation_metadata() or ())

    async def StreamMotion(self, request_iterator: AsyncIterator[bytes], context: StreamContext) -> None:
        """One stream, from its hello to its end."""
        try:
            peer, caller = await self._admission.charge(context)
            self._note_call(context)
            stream = self._begin(peer, caller)
        except StreamRefused as refusal:
            await refuse(context, refusal)
        try:
            await self._serve(stream, context)
        finally:
            self._end(stream)

    def _begin(self, peer: Peer, caller: Caller) -> Stream:
        """Begin a stream. Raises StreamRefused if there is no place for one more."""
        if len(self._streams) >= self._limits.max_streams:
            raise too_many_streams(self._limits.max_streams)
        if peer.num_streams >= peer.limits.streams:
            raise too_many_streams(peer.limits.streams, peer.kind)
        stream = Stream(next(self._numbers), self._models, self._stream_metrics, self._kept, peer)
        stream.flush_s = self._flush_s
        stream.tracing = None if self._record_window is None else StreamTracing(self._record_window)
        stream.caller = caller
        if self._others is not None:
            stream.other_servers = self._others.named
        stream.gateway_lag = self._lag
        stream.accepts_opens = self._reader.ends_at is None
        peer.begin_stream()
        self._streams[stream.number] = stream
        self._all_ended.clear()
        self.watch.begin()
        self._lag.begin()
        return stream

    def _end(self, stream: Stream) -> None:
        try:
            stream.lose()
        finally:  # whatever went wrong, its place becomes free
            if stream.tracing is not None:
                stream.tracing.end_all()
            stream.peer.end_stream()
            del self._streams[stream.number]
            if not self._streams:
                self._all_ended.set()

    async def _serve(self, stream: Stream, context: StreamContext) -> None:
        reader = asyncio.create_task(self._reader.read(stream, context))
        writer = asyncio.create_task(write(stream, context))
        stream.cut = partial(cut, stream, writer)
        try:
            await asyncio.wait({reader, writer}, return_when=asyncio.FIRST_COMPLETED)
            if stream.refusal is not None:
                await asyncio.wait({writer})  # the writer was cut, but the first response may still be under way
                raise stream.refusal
            if reader.done() and not reader.exception():
                # A lost connection also looks as if the client had finished; only a write can tell the difference.
                await asyncio.wait({stream.probe(), writer}, return_when=asyncio.FIRST_COMPLETED)
                await stream.taken_over(writer)
            if reader.done():
                stream.close_all(CloseReason.CLIENT)
                stream.end()
            # Wait for its end even if the stream is refused: a status set during a write may never arrive.
            await asyncio.wait({writer})
            if stream.refusal is not None:
                raise stream.refusal
            writer.result()
            if reader.done():
                reader.result()  # raises StreamRefused
        except StreamRefused as refusal:
            await refuse(context, refusal)
        except Exception as error:
            await refuse(context, stream_failed(stream.number, error))
        finally:
            for task in (reader, writer):
                task.cancel()

    # ---- the server's end -------------------------------------------------------------------------------------------

    def goodbye(self, grace_s: float) -> None:
        """Open nothing more, and tell every client that the server will be gone in grace_s seconds."""
        self._reader.ends_at = time.monotonic() + grace_s
        for stream in self._streams.values():
            stream.accepts_opens = False
            if stream.greeted:  # otherwise the goodbye follows the hello, which has to come first
                say_draining(stream, self._models.default.model_id, grace_s, self._limits.reconnect_after_s)

    def send_away(self) -> None:
        """End every stream, as nothing can be served here: clients then continue their sessions on other servers."""
        for stream in list(self._streams.values()):
            if stream.greeted:
                say_draining(stream, self._models.default.model_id, 0.0)
            stream.close_all(CloseReason.DRAINED)
            stream.end()

    def close_model(self, model: LoadedModel) -> int:
        """Close every session and clip of a model that is being unloaded; returns the number of sessions."""
        self.clips.close_model(model)
        carried = sum(stream.close_all(CloseReason.MODEL_UNLOADED, model) for stream in list(self._streams.values()))
        return carried + self._kept.close_parked(CloseReason.MODEL_UNLOADED, model)

    def close_all(self) -> None:
        """Close every session as DRAINED, end every stream once its client has been told, and end all clips."""
        for stream in list(self._streams.values()):
            stream.close_all(CloseReason.DRAINED)
            stream.end()
        self._kept.close_parked(CloseReason.DRAINED)
        self.clips.close_all()

    def write_last_snapshots(self) -> None:
        """Once all sessions are closed: save what still waits, for a moment at most, and close the store."""
        if self._others is not None:
            self._others.close()
        if self.durability is not None:
            self.durability.close()

    async def finished(self) -> None:
        """Wait until no stream and no clip is left."""
        await self._all_ended.wait()
        await self.clips.finished()
