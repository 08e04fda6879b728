"""Load for the server with the null runner: bare gRPC streams, as light as Python can make them.

There are three kinds. `Line.advance_for`: all sessions of a stream advance together, again and again, so that a message
carries as many chunks as the stream has sessions; only the null engine can be driven like this. `Paced`: sessions play
in real time and edit every five seconds; latency counts from when an edit should have been sent, even if the generator
was late. `exchange`: messages of a given size, with gRPC alone.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import grpc.aio

from motiongen.v1 import motion_pb2, service_pb2, service_pb2_grpc, session_pb2

FPS = 20
LOOKAHEAD = 40
REPORTS_HZ = 2.0
TICK_S = 0.025
EDIT_EVERY_S = 5.0
LONGEST_EDIT_GAP_S = 0.31  # so that even a few sessions give enough edits
STREAMS_A_CHANNEL = 100
OPENS_A_MESSAGE = 64
CHANNEL_OPTIONS = (("grpc.use_local_subchannel_pool", 1), ("grpc.max_receive_message_length", 8 << 20))
SERVICE_NAME = service_pb2.DESCRIPTOR.services_by_name["MotionService"].full_name


@dataclass(slots=True)
class Counts:
    """Received: messages with updates, chunks in them, their frames, all bytes. Sent: requests, bytes."""

    messages: int = 0
    chunks: int = 0
    frames: int = 0
    num_bytes: int = 0
    requests: int = 0
    request_bytes: int = 0

    def minus(self, other: Counts) -> Counts:
        return Counts(*(getattr(self, name) - getattr(other, name) for name in COUNTED))


COUNTED = tuple(Counts.__dataclass_fields__)


class Channels:
    """Connections to one server, each with as many streams as it allows."""

    def __init__(self, address: str) -> None:
        self._address = address
        self._channels: list[grpc.aio.Channel] = []
        self._streams = 0

    def stream(self) -> Any:
        """Start another call of StreamMotion."""
        return service_pb2_grpc.MotionServiceStub(self._channel()).StreamMotion()

    def bare_stream(self) -> Any:
        """Start another call of StreamMotion that takes and gives raw bytes."""
        return self._channel().stream_stream(f"/{SERVICE_NAME}/StreamMotion")()

    def _channel(self) -> grpc.aio.Channel:
        if self._streams % STREAMS_A_CHANNEL == 0:
            self._channels.append(grpc.aio.insecure_channel(self._address, options=CHANNEL_OPTIONS))
        self._streams += 1
        return self._channels[-1]

    async def close(self) -> None:
        await asyncio.gather(*(channel.close() for channel in self._channels))


class Line:
    """One stream with handles from 0: its sessions, what each has received, and the edits that are under way."""

    def __init__(self, channels: Channels, num_sessions: int) -> None:
        self.num_sessions = num_sessions
        self.counts = Counts()
        self.sent_to = [0] * num_sessions
        self.seqs = [1] * num_sessions
        self.intended: dict[tuple[int, int], float] = {}
        self.latencies_s: list[float] = []
        self.pings_s: list[float] = []
        self._answered: dict[int, list[int]] = {}
        self._call = channels.stream()
        self._writing = asyncio.Lock()

    async def open(self) -> None:
        """Open all sessions, a few at a time, and wait for the first frames of each."""
        await self.write(service_pb2.StreamMotionRequest(hello=service_pb2.ClientHello(client_agent="null-load")))
        for first in range(0, self.num_sessions, OPENS_A_MESSAGE):
            handles = range(first, min(first + OPENS_A_MESSAGE, self.num_sessions))
            events = [
                session_pb2.SessionEvent(
                    session=handle,
                    event_seq=1,
                    open=session_pb2.OpenSession(seed=handle, lookahead_frames=LOOKAHEAD, denoise_steps=2),
                )
                for handle in handles
            ]
            await self.write(service_pb2.StreamMotionRequest(events=events))
            while min(self.sent_to[first : handles.stop]) < LOOKAHEAD:
                await self.read()

    async def write(self, request: service_pb2.StreamMotionRequest) -> None:
        self.counts.requests += 1
        self.counts.request_bytes += request.ByteSize()
        async with self._writing:  # edits and reports come from two tasks, and a call takes one message at a time
            await self._call.write(request)

    async def read(self) -> None:
        """Read one response."""
        response = await self._call.read()
        now = time.perf_counter()
        if not isinstance(response, service_pb2.StreamMotionResponse):
            raise RuntimeError(f"the server ended the stream: {await self._call.code()}, {await self._call.details()}")
        if response.HasField("pong"):
            self.pings_s.append(now - response.pong.client_time_ns / 1e9)
        if response.updates:
            self.counts.messages += 1
            self.counts.num_bytes += response.ByteSize()
        for update in response.updates:
            self._take(update, now)

    def _take(self, update: session_pb2.SessionUpdate, now: float) -> None:
        kind, handle = update.WhichOneof("update"), update.session
        if kind == "chunk":
            self.counts.chunks += 1
            self.counts.frames += update.chunk.frame_count
            self.sent_to[handle] = update.chunk.first_frame + update.chunk.frame_count
            for seq in self._answered.pop(handle, ()):
                self.latencies_s.append(now - self.intended.pop((handle, seq)))
        elif kind == "plan":
            self.sent_to[handle] = min(self.sent_to[handle], update.plan.valid_from)
            if update.plan.event_seqs:
                self._answered.setdefault(handle, []).extend(update.plan.event_seqs)
        elif kind == "closed" or (kind == "outcome" and update.outcome.code):
            raise RuntimeError(f"session {handle}: {update}")

    async def read_to(self, frame: int) -> None:
        """Read until every session has received the frames below `frame`."""
        while min(self.sent_to) < frame:
            await self.read()

    def reports(self, frame: int, handles: Sequence[int]) -> service_pb2.StreamMotionRequest:
        """A message with the playheads of some sessions."""
        return service_pb2.StreamMotionRequest(
            events=[
                session_pb2.SessionEvent(
                    session=handle, playhead=session_pb2.Playhead(frame=frame, buffered_to=self.sent_to[handle])
                )
                for handle in handles
            ]
        )

    def edit(self, handle: int, text: str, intended_s: float) -> service_pb2.StreamMotionRequest:
        """A message with a new prompt for one session."""
        self.seqs[handle] += 1
        self.intended[handle, self.seqs[handle]] = intended_s
        span = session_pb2.EditPrompts(upsert=[motion_pb2.PromptSpan(prompt_id=1, text=text)])
        event = session_pb2.SessionEvent(session=handle, event_seq=self.seqs[handle], edit_prompts=span)
        return service_pb2.StreamMotionRequest(events=[event])

    async def advance_for(self, seconds: float, chunk_frames: int) -> None:
        """Advance all sessions by a chunk each per round, as fast as the answers come."""
        frame = min(self.sent_to) - LOOKAHEAD
        ends_s = time.perf_counter() + seconds
        while time.perf_counter() < ends_s:
            frame += chunk_frames
            await self.write(self.reports(frame, range(self.num_sessions)))
            await self.read_to(frame + LOOKAHEAD)

    def cancel(self) -> None:
        self._call.cancel()


def total(lines: Sequence[Line]) -> Counts:
    return Counts(*(sum(getattr(line.counts, name) for line in lines) for name in COUNTED))


async def exchange(channels: Channels, request_bytes: int, every_s: float, seconds: float) -> int:
    """On one stream, send a message every every_s and wait for each answer. Returns how many were exchanged."""
    call = channels.bare_stream()
    request, count, begun_s = bytes(request_bytes), 0, time.perf_counter()
    while (now := time.perf_counter()) < begun_s + seconds:
        await call.write(request)
        if await call.read() is grpc.aio.EOF:
            raise RuntimeError(f"the server ended the stream: {await call.code()}, {await call.details()}")
        count += 1
        await asyncio.sleep(max(0.0, now + every_s - time.perf_counter()))
    call.cancel()
    return count


@dataclass
class PacedResult:
    """In seconds. edits: from the intended time to the first changed frames; lags: how late the generator sent."""

    edits_s: list[float] = field(default_factory=list)
    pings_s: list[float] = field(default_factory=list)
    lags_s: list[float] = field(default_factory=list)
    unanswered: int = 0


class Paced:
    """Plays all sessions of all streams in real time; edits and pings are sent one by one at even intervals."""

    def __init__(self, lines: Sequence[Line]) -> None:
        self._lines = lines
        self._sessions = [(line, handle) for line in lines for handle in range(line.num_sessions)]
        self._result = PacedResult()
        self._measuring = False

    async def run(self, warm_up_s: float, seconds: float) -> PacedResult:
        started_s = time.perf_counter()
        tasks = [asyncio.create_task(self._edits(started_s)), asyncio.create_task(self._pings(started_s))]
        tasks += [asyncio.create_task(self._reports(line, started_s, n)) for n, line in enumerate(self._lines)]
        tasks += [asyncio.create_task(self._reads(line)) for line in self._lines]
        timer = asyncio.create_task(asyncio.sleep(warm_up_s))
        await self._until(timer, tasks)
        for line in self._lines:
            line.latencies_s.clear()
            line.pings_s.clear()
        self._measuring = True
        await self._until(asyncio.create_task(asyncio.sleep(seconds)), tasks)
        self._measuring = False
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        now = time.perf_counter()
        for line in self._lines:
            self._result.edits_s += line.latencies_s
            self._result.pings_s += line.pings_s
            self._result.unanswered += sum(now - intended_s > 1.0 for intended_s in line.intended.values())
        return self._result

    @staticmethod
    async def _until(timer: asyncio.Task[None], tasks: Sequence[asyncio.Task[None]]) -> None:
        """Wait for the timer; a task that ends earlier has failed."""
        done, _ = await asyncio.wait([timer, *tasks], return_when=asyncio.FIRST_COMPLETED)
        for task in done - {timer}:
            task.result()

    async def _at(self, moment_s: float) -> None:
        delay_s = moment_s - time.perf_counter()
        if delay_s > 0:
            await asyncio.sleep(delay_s)
        if self._measuring:
            self._result.lags_s.append(time.perf_counter() - moment_s)

    async def _reports(self, line: Line, started_s: float, number: int) -> None:
        """Report each session's playhead at 2 Hz; sessions of a stream that report in the same tick share a message."""
        groups = round(1 / REPORTS_HZ / TICK_S)
        every_s = TICK_S if line.num_sessions >= groups else 1 / REPORTS_HZ
        spread_s = (number * 0.618033988749895) % 1.0 * every_s  # so that streams do not tick together
        tick = 0
        while True:
            tick += 1
            moment_s = started_s + spread_s + tick * every_s
            await self._at(moment_s)
            step = groups if line.num_sessions >= groups else 1
            handles = range(tick % step, line.num_sessions, step)
            if handles:
                await line.write(line.reports(int((moment_s - started_s) * FPS), handles))

    async def _edits(self, started_s: float) -> None:
        every_s = min(EDIT_EVERY_S / len(self._sessions), LONGEST_EDIT_GAP_S)
        number = 0
        while True:
            number += 1
            moment_s = started_s + 0.5 + number * every_s
            await self._at(moment_s)
            line, handle = self._sessions[number * 617 % len(self._sessions)]
            text = "walk" if number // len(self._sessions) % 2 else "run"
            await line.write(line.edit(handle, text, moment_s))

    async def _pings(self, started_s: float) -> None:
        number = 0
        while True:
            number += 1
            moment_s = started_s + number * 0.0217
            await self._at(moment_s)
            ping = service_pb2.Ping(client_time_ns=int(moment_s * 1e9))
            await self._lines[number % len(self._lines)].write(service_pb2.StreamMotionRequest(ping=ping))

    @staticmethod
    async def _reads(line: Line) -> None:
        while True:
            await line.read()
