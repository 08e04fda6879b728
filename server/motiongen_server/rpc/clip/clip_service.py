"""ClipService: takes clip calls, has an engine generate their samples, and sends the frames as they come."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import grpc
import grpc.aio

from motiongen.v1 import service_pb2
from motiongen_server.engine.types import Chunk, Close, CloseReason, Code, Open, Output, Playhead
from motiongen_server.engine.types.refusals import draining
from motiongen_server.errors import EventRefused, StreamRefused
from motiongen_server.models.registry import LoadedModel, ModelRegistry
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.budgets.stream_budget import CONSTRAINT_CALLS, PATH_CALLS
from motiongen_server.rpc.budgets.waiting_memory import WaitingMemory
from motiongen_server.rpc.calls.bounded_write import write_within
from motiongen_server.rpc.calls.context import CallContext
from motiongen_server.rpc.calls.work import work_for
from motiongen_server.rpc.clip.call import Call, refused
from motiongen_server.rpc.clip.holding import Holding
from motiongen_server.rpc.clip.request import check_extent, clip_specs, opening_event
from motiongen_server.rpc.convert import UNENCODED, coding_of, num_paths, prompt_texts, warnings_of, with_embeddings
from motiongen_server.rpc.errors.events import too_many_clips
from motiongen_server.rpc.errors.streams import CLIENT_GONE, failed_inside
from motiongen_server.rpc.limits import ServiceLimits
from motiongen_server.rpc.request_parts import TAKEN_APART
from motiongen_server.rpc.sessions.encoding import encoded
from motiongen_server.rpc.stream_metrics import NoStreamMetrics, StreamMetrics
from motiongen_server.text.turns import Asker


class ClipService:
    """Answers GenerateClip. Lives on the event loop of the service."""

    def __init__(
        self,
        models: ModelRegistry,
        numbers: Iterator[int],
        stream_metrics: StreamMetrics | None = None,
        limits: ServiceLimits | None = None,
        memory: WaitingMemory | None = None,
    ) -> None:
        """numbers: stream numbers, one of which identifies each call to the engine.

        memory: accounts for what calls hold; by default an account of its own.
        """
        self._models = models
        self._limits = limits or ServiceLimits()
        self._numbers = numbers
        self._stream_metrics = stream_metrics or NoStreamMetrics()
        self._memory = memory or WaitingMemory(self._limits.max_waiting_bytes, {})
        self._calls: dict[int, Call] = {}
        self._holdings: dict[int, Holding] = {}  # of those, and of calls that have not begun yet
        self._closing = False
        self._idle = asyncio.Event()
        self._idle.set()

    def take(self, number: int, outputs: Sequence[Output]) -> None:
        """Take outputs of the engine for a call; those for a call that has ended are dropped."""
        holding = self._holdings.get(number)
        if holding is not None:
            holding.put(outputs)

    def close_all(self) -> None:
        """End every call, and begin no more."""
        self._closing = True
        for call in self._calls.values():
            self._stop(call, CloseReason.DRAINED)

    def close_model(self, model: LoadedModel) -> None:
        """End every call whose model is being unloaded."""
        for call in self._calls.values():
            if call.model is model:
                self._stop(call, CloseReason.MODEL_UNLOADED)

    async def finished(self) -> None:
        """Wait until no call is left."""
        await self._idle.wait()

    async def generate(self, request: service_pb2.GenerateClipRequest, context: CallContext, peer: Peer) -> None:
        """Answer one call. Its samples stop within a step when its client has gone or its time is up."""
        begun_at, code, number = time.monotonic(), "CANCELLED", next(self._numbers)
        holding = Holding(TAKEN_APART * request.ByteSize(), self._memory.note, peer.name)
        self._holdings[number] = holding
        self._memory.begin(number, holding)
        remaining_s = context.time_remaining()  # if the call is cancelled or expires, gRPC cancels this task
        most_s = self._models.limits.max_clip_s
        try:
            async with asyncio.timeout(most_s if remaining_s is None else min(most_s, remaining_s)) as within:
                holding.cut = partial(_cut, within)
                self._memory.note(holding.num_waiting_bytes)  # may end the call
                await self._make(request, number, context, peer)
            code = "OK"
        except TimeoutError:
            end = holding.refusal or _too_slow(time.monotonic() - begun_at)
            code = end.code.name
            await context.abort_with_status(end.status())
        except EventRefused as refusal:
            code = refusal.code.name
            if refusal.code is Code.RESOURCE_EXHAUSTED:
                self._stream_metrics.reject(refusal.reason)
            await context.abort_with_status(StreamRefused.of(refusal).status())
        except StreamRefused as refusal:
            code = refusal.code.name
            await context.abort_with_status(refusal.status())
        except CLIENT_GONE:
            pass  # there is no client to tell
        except Exception as error:
            code = "INTERNAL"
            failure = failed_inside("a clip failed", "the clip failed inside the server", error)
            await context.abort_with_status(failure.status())
        finally:
            del self._holdings[number]
            self._memory.end(number)
            # Limited: a call that was refused for its sample count must not outweigh all others in the metrics.
            num_samples = min(request.sample_count or 1, self._models.limits.max_clip_samples)
            self._stream_metrics.end_clip(code, time.monotonic() - begun_at, num_samples)

    async def _make(
        self, request: service_pb2.GenerateClipRequest, number: int, context: CallContext, peer: Peer
    ) -> None:
        with work_for(peer):
            model = self._admitted(request, peer)
        try:
            call = await self._prepared(request, number, model, peer)
            await self._run(call, number, context, peer)
        finally:
            peer.end_clip(request.sample_count or 1)

    def _admitted(self, request: service_pb2.GenerateClipRequest, peer: Peer) -> LoadedModel:
        """The model that generates the samples. From now on they count among the peer's, and are charged.

        Raises EventRefused.
        """
        model = self._models.find(request.open.model_id)
        check_extent(request, model.catalog)
        if len(self._calls) >= self._limits.max_clip_calls:
            raise too_many_clips(self._limits.max_clip_calls)
        num_samples = request.sample_count or 1
        told = request.open.constraints
        each_calls = CONSTRAINT_CALLS * len(told) + PATH_CALLS * num_paths(told)
        peer.calls.charge(each_calls * num_samples, time.monotonic())
        peer.begin_clip(num_samples)
        return model

    async def _prepared(
        self, request: service_pb2.GenerateClipRequest, number: int, model: LoadedModel, peer: Peer
    ) -> Call:
        """The call. Everything that is wrong with it is found before its prompts are encoded. Raises EventRefused."""
        received_at, catalog = time.monotonic(), model.catalog
        with work_for(peer):
            event = opening_event(request)
            texts = prompt_texts(event, catalog)
            specs = clip_specs(request, number, UNENCODED, received_at, catalog, peer.owner)
            if texts:
                refusal = model.engine.refusal_of(specs[0].priority, specs[0].denoise_steps, is_clip=True)
                if refusal is not None:
                    raise refusal
        if texts:
            asker = Asker(peer.name, number)
            embeddings = await encoded(model.prompts, texts, asker, peer.prompts)
            prompts = with_embeddings(specs[0].prompts, embeddings)
            specs = [replace(spec, prompts=prompts) for spec in specs]
        with work_for(peer):
            coding = coding_of(request.open, catalog)
            warnings = warnings_of(event, Open(specs[0], 1, received_at), catalog)
        return Call(specs, model, coding, warnings)

    async def _run(self, call: Call, number: int, context: CallContext, peer: Peer) -> None:
        self._calls[number] = call
        holding = self._holdings[number]
        self._idle.clear()
        try:
            with work_for(peer):
                self._start(call, time.monotonic())
            while call.under_way:
                output = await holding.next()
                for response in call.responses(output):
                    await self._write(response, context)
                holding.done(output)
                if isinstance(output, Chunk) and output.session in call.under_way:
                    self._grant(call, output)
        finally:
            self._stop(call, CloseReason.CLIENT)
            del self._calls[number]
            if not self._calls:
                self._idle.set()

    async def _write(self, response: service_pb2.GenerateClipResponse, context: CallContext) -> None:
        """Raises StreamRefused if the client reads nothing for too long: its samples keep others waiting."""
        await write_within(self._limits.stuck_timeout_s, context.write(response))

    @staticmethod
    def _grant(call: Call, chunk: Chunk) -> None:
        """The client took frames, so as many more may be made: a client that does not read gets no more made for it."""
        frame = chunk.first_frame + len(chunk.rows)
        call.model.engine.submit(Playhead(chunk.session, 0, time.monotonic(), frame, frame, 0, None))

    def _start(self, call: Call, received_at: float) -> None:
        if self._closing:
            raise draining()
        for spec in call.specs:
            refusal = call.model.engine.submit(Open(spec, 1, received_at))
            if refusal is not None:
                raise refused(refusal)
            call.under_way.add(spec.session)

    def _stop(self, call: Call, reason: CloseReason) -> None:
        """Have the engine drop the samples that are not complete."""
        for key in call.under_way:
            call.model.engine.submit(Close(key, 2, time.monotonic(), reason))


def _cut(within: asyncio.Timeout) -> None:
    """Let a timeout expire now, unless it has already."""
    if not within.expired():
        within.reschedule(asyncio.get_running_loop().time())


def _too_slow(waited_s: float) -> StreamRefused:
    return StreamRefused(
        grpc.StatusCode.DEADLINE_EXCEEDED,
        "CLIP_TOO_SLOW",
        f"the clip was not finished within {waited_s:.3g} s; ask for less, or give it a longer deadline",
    )
