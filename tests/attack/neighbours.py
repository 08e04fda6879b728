"""Neighbours: sessions of good clients that play in real time with some edits, and what they notice of an attack."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import ExitStack, asynccontextmanager
from dataclasses import dataclass, field

import grpc.aio
import numpy as np

from motiongen.v1 import motion_pb2, service_pb2, service_pb2_grpc, session_pb2
from tests.attack.good_stream import GoodStream
from tests.attack.tokens import Metadata
from tests.server.engine_process.audience import stopped
from tests.waiting import LIMIT_S

FPS = 20
LOOKAHEAD = 40
REPORT_EVERY_S = 0.25
EDIT_EVERY_S = 2.0
TIER_FULL = session_pb2.SERVICE_TIER_FULL


@dataclass
class Playing:
    """One session, whose playhead moves in real time from its first frame on. had: frames in hand when counting began
    again."""

    handle: int
    sent_to: int = 0
    begun_s: float | None = None
    due: int = 0
    missed: int = 0
    seq: int = 1
    had: int = 0
    lowest_tier: int = TIER_FULL
    closed: str = ""
    edits: dict[int, float] = field(default_factory=dict)

    @property
    def in_hand(self) -> int:
        """Frames that have arrived and are not due yet; negative if due frames have not arrived."""
        return self.sent_to - self.due

    def play(self, now: float) -> None:
        """Show the frames that are due by now; those that have not arrived are missed."""
        if self.begun_s is None:
            return
        due = int((now - self.begun_s) * FPS)
        if due > self.due:
            self.missed += max(0, due - max(self.sent_to, self.due))
            self.due = due


@dataclass(frozen=True)
class Noticed:
    """What all neighbours noticed. frames: how many were due; missed: the share of them; edits_ms: from an edit to its
    answer.

    behind: the share of shown frames that no new frames have made up for. So many fewer are in hand, and frames will
    be missed if it goes on.
    """

    frames: int
    missed: float
    behind: float
    edits_ms: tuple[float, ...]
    pings_ms: tuple[float, ...]
    lowest_tier: int
    closed: tuple[str, ...]

    @property
    def edit_p95_ms(self) -> float:
        return float(np.percentile(self.edits_ms, 95)) if self.edits_ms else float("inf")

    @property
    def ping_p95_ms(self) -> float:
        return float(np.percentile(self.pings_ms, 95)) if self.pings_ms else float("inf")


class Neighbour(GoodStream):
    """A stream with sessions that play."""

    def __init__(
        self,
        stub: service_pb2_grpc.MotionServiceStub,
        num_sessions: int,
        new_prompt: Callable[[], str] | None = None,
        metadata: Metadata = (),
    ) -> None:
        """new_prompt: the prompt of each edit; without it, two prompts alternate. metadata: of its call."""
        super().__init__(stub, metadata)
        self._new_prompt = new_prompt
        self.sessions = [Playing(handle) for handle in range(num_sessions)]
        self.edits_ms: list[float] = []
        self.pings_ms: list[float] = []
        self.lost = ""

    async def ask(self) -> None:
        """Open all sessions; return once the gateway has given each to an engine."""
        hello = service_pb2.ClientHello(client_agent="neighbour")
        opens = [
            session_pb2.SessionEvent(
                session=each.handle, event_seq=1,
                open=session_pb2.OpenSession(lookahead_frames=LOOKAHEAD, priority=session_pb2.PRIORITY_CLASS_NEAR),
            )
            for each in self.sessions
        ]  # fmt: skip
        ping = service_pb2.Ping(client_time_ns=int(time.perf_counter() * 1e9))
        await self._write(service_pb2.StreamMotionRequest(hello=hello, events=opens))
        await self._write(service_pb2.StreamMotionRequest(ping=ping))
        self._tasks = [asyncio.create_task(self._read())]
        await self._until(lambda: bool(self.pings_ms))

    async def _until(self, condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(LIMIT_S):
            while not condition():
                if told := self.lost or next((each.closed for each in self.sessions if each.closed), ""):
                    raise RuntimeError(f"a neighbour was not admitted, before any attack: {told}")
                await asyncio.sleep(0.02)

    async def begin(self) -> None:
        """Wait until all sessions play. Raises RuntimeError if one is refused, TimeoutError."""
        await self._until(lambda: all(each.begun_s for each in self.sessions))
        self._tasks += [asyncio.create_task(self._report()), asyncio.create_task(self._edit())]

    async def _read(self) -> None:
        try:
            while isinstance(response := await self._call.read(), service_pb2.StreamMotionResponse):
                now = time.perf_counter()
                if response.HasField("pong"):
                    self.pings_ms.append(1000 * (now - response.pong.client_time_ns / 1e9))
                for update in response.updates:
                    self._take(update, now)
            self.lost = "the stream ended"
        except grpc.aio.AioRpcError as error:
            self.lost = f"{error.code().name}: {error.details()}"

    def _take(self, update: session_pb2.SessionUpdate, now: float) -> None:
        session = self.sessions[update.session]
        session.play(now)
        kind = update.WhichOneof("update")
        if kind == "chunk":
            session.sent_to = update.chunk.first_frame + update.chunk.frame_count
            session.begun_s = session.begun_s or now
        elif kind == "plan":
            session.sent_to = min(session.sent_to, update.plan.valid_from)
        elif kind == "outcome":
            asked_s = session.edits.pop(update.outcome.event_seq, None)
            if asked_s is not None and not update.outcome.code:
                self.edits_ms.append(1000 * (now - asked_s))
            elif update.outcome.code:
                session.closed = f"refused: {update.outcome.reason}"
        elif kind == "service_level":
            session.lowest_tier = max(session.lowest_tier, update.service_level.tier)
        elif kind == "closed":
            session.closed, session.begun_s = session_pb2.CloseReason.Name(update.closed.reason), None

    async def _report(self) -> None:
        while not self.lost:
            now = time.perf_counter()
            events = []
            for each in self.sessions:
                each.play(now)
                playhead = session_pb2.Playhead(frame=min(each.due, max(0, each.sent_to - 1)), buffered_to=each.sent_to)
                events.append(session_pb2.SessionEvent(session=each.handle, playhead=playhead))
            ping = service_pb2.Ping(client_time_ns=int(now * 1e9))
            await self._write(service_pb2.StreamMotionRequest(events=events, ping=ping))
            await asyncio.sleep(REPORT_EVERY_S)

    async def _edit(self) -> None:
        number = 0
        while not self.lost:
            await asyncio.sleep(EDIT_EVERY_S / len(self.sessions))
            session = self.sessions[number % len(self.sessions)]
            number += 1
            if session.closed:
                continue
            session.seq += 1
            text = "a person walks forward" if number % 2 else "a person waves"
            if self._new_prompt is not None:
                text = self._new_prompt()
            span = motion_pb2.PromptSpan(prompt_id=1, text=text)
            edit = session_pb2.EditPrompts(upsert=[span])
            session.edits[session.seq] = time.perf_counter()
            event = session_pb2.SessionEvent(session=session.handle, event_seq=session.seq, edit_prompts=edit)
            await self._write(service_pb2.StreamMotionRequest(events=[event]))

    def forget(self) -> None:
        """Discard what was noticed so far."""
        now = time.perf_counter()
        self.edits_ms.clear()
        self.pings_ms.clear()
        for session in self.sessions:
            if session.closed:
                continue
            session.play(now)
            session.missed, session.begun_s, session.had = 0, now - session.due / FPS, session.in_hand

    async def end(self) -> None:
        self.lost = self.lost or " "
        await super().end()


class Neighbours:
    """All neighbours."""

    def __init__(self, streams: Sequence[Neighbour]) -> None:
        self._streams = streams
        self._frames_before = 0

    def forget(self) -> None:
        """Discard what was noticed before the attack."""
        for each in self._streams:
            each.forget()
        self._frames_before = self._frames()

    @property
    def _live(self) -> list[Playing]:
        return [session for each in self._streams for session in each.sessions if not session.closed]

    async def again_s(self) -> float:
        """Seconds until every remaining session has received another frame. The players, who have waited, continue from
        there with half a second in hand. Raises TimeoutError.
        """
        begun_s = time.perf_counter()
        before = {id(session): session.sent_to for session in self._live}
        async with asyncio.timeout(LIMIT_S):
            # There is no event for it.
            while any(session.sent_to <= before[id(session)] for session in self._live):  # noqa: ASYNC110
                await asyncio.sleep(0.01)
        now = time.perf_counter()
        for session in self._live:
            session.due = min(session.due, max(0, session.sent_to - FPS // 2))
            session.begun_s = now - session.due / FPS
        self.forget()
        return now - begun_s

    def _frames(self) -> int:
        return sum(session.due for each in self._streams for session in each.sessions)

    def noticed(self) -> Noticed:
        now = time.perf_counter()
        sessions = [session for each in self._streams for session in each.sessions]
        for session in sessions:
            session.play(now)
        frames = self._frames() - self._frames_before
        unanswered = [1000 * (now - asked_s) for session in sessions for asked_s in session.edits.values()]
        lost = [each.lost for each in self._streams if each.lost]
        return Noticed(
            frames,
            sum(session.missed for session in sessions) / max(1, frames),
            sum(max(0, session.had - session.in_hand) for session in sessions if not session.closed) / max(1, frames),
            tuple([ms for each in self._streams for ms in each.edits_ms] + [ms for ms in unanswered if ms > 1000]),
            tuple(ms for each in self._streams for ms in each.pings_ms),
            max(session.lowest_tier for session in sessions),
            tuple(lost + [session.closed for session in sessions if session.closed]),
        )


@asynccontextmanager
async def neighbours(
    address: str,
    streams: int = 3,
    sessions: int = 4,
    *,
    new_prompts: bool = False,
    metadata: Metadata = (),
    engines: Sequence[int] = (),
) -> AsyncIterator[Neighbours]:
    """Streams that play, with a connection each. new_prompts: each edit has a prompt that is new to the server.

    metadata: of their calls. engines: processes that are stopped while sessions are assigned to them: they then report
    no load, which on a busy machine would differ between them, so that each gets the same number.
    """
    numbers = itertools.count()
    new_prompt = (lambda: f"a person waves {next(numbers)} times") if new_prompts else None
    channels = [
        grpc.aio.insecure_channel(address, options=(("grpc.use_local_subchannel_pool", 1),)) for _ in range(streams)
    ]
    stubs = [service_pb2_grpc.MotionServiceStub(channel) for channel in channels]
    playing = [Neighbour(stub, sessions, new_prompt, metadata) for stub in stubs]
    try:
        with ExitStack() as standing:
            for pid in engines:
                standing.enter_context(stopped(pid))
            await asyncio.gather(*(each.ask() for each in playing))
        await asyncio.gather(*(each.begin() for each in playing))
        yield Neighbours(playing)
    finally:
        await asyncio.gather(*(each.end() for each in playing))
        await asyncio.gather(*(channel.close() for channel in channels))
