"""A bare client for the compliance suite: it says what a test tells it to, and checks every rule on what it hears."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import grpc.aio
import numpy as np

from motiongen.v1 import motion_pb2, service_pb2, service_pb2_grpc, session_pb2

LIMIT_S = 20.0
"""How long a message may take before the test fails; nothing is measured by it."""
REPORT_PERIOD_S = 0.2
"""Between two reports of one playhead: credit is earned in real time, and told by reports."""


class RuleBroken(AssertionError):
    """The server did what the protocol forbids."""


class StreamOver(Exception):
    """The stream ended with OK while the test waited for more."""


def require(holds: bool, rule: str) -> None:
    if not holds:
        raise RuleBroken(rule)


def span(text: str = "walk", prompt_id: int = 1, start: int = 0, end: int = 0) -> motion_pb2.PromptSpan:
    return motion_pb2.PromptSpan(prompt_id=prompt_id, start_frame=start, end_frame=end, text=text)


def waypoint(frame: int, constraint_id: int = 1, **root: float) -> motion_pb2.Constraint:
    return motion_pb2.Constraint(constraint_id=constraint_id, frame=frame, waypoint=motion_pb2.Waypoint(**root))


def edit_prompts(*upsert: motion_pb2.PromptSpan, remove: Sequence[int] = ()) -> session_pb2.SessionEvent:
    return session_pb2.SessionEvent(edit_prompts=session_pb2.EditPrompts(upsert=upsert, remove=remove))


def edit_constraints(*upsert: motion_pb2.Constraint, remove: Sequence[int] = ()) -> session_pb2.SessionEvent:
    return session_pb2.SessionEvent(edit_constraints=session_pb2.EditConstraints(upsert=upsert, remove=remove))


def play_state(state: int) -> session_pb2.SessionEvent:
    return session_pb2.SessionEvent(set_play_state=session_pb2.SetPlayState(state=state))  # type: ignore[arg-type]


def close() -> session_pb2.SessionEvent:
    return session_pb2.SessionEvent(close=session_pb2.CloseSession())


PAUSE = play_state(session_pb2.PLAY_STATE_PAUSED)
RESUME = play_state(session_pb2.PLAY_STATE_PLAYING)


@dataclass
class Heard:
    """What was said of one session, checked as it comes. sent_seq: the last number the test has used."""

    row_bytes: int
    sent_seq: int = 1
    playhead: int = 0
    opened: session_pb2.SessionOpened | None = None
    closed: session_pb2.SessionClosed | None = None
    is_resuming: bool = False
    goes_on_at: int = 0
    attempt: int = 0
    frames: dict[int, bytes] = field(default_factory=dict)
    plans: list[session_pb2.PlanNotice] = field(default_factory=list)
    chunks: list[motion_pb2.FrameChunk] = field(default_factory=list)
    outcomes: list[session_pb2.EditOutcome] = field(default_factory=list)
    levels: list[session_pb2.ServiceLevel] = field(default_factory=list)
    reached: list[session_pb2.ConstraintReached] = field(default_factory=list)
    applied_seq: int = 0
    next_frame: int = 0
    end: int = 0
    committed_to: int = 0

    def take(self, update: session_pb2.SessionUpdate) -> None:
        require(self.closed is None, "nothing is said of a session after SessionClosed")
        kind = update.WhichOneof("update")
        if self.is_resuming and kind == "outcome":
            require(update.outcome.event_seq == 1, "nothing but its refusal is told before a session is resumed")
        else:
            require(update.applied_seq >= self.applied_seq, "applied_seq never falls")
            self.applied_seq = update.applied_seq
        require(kind is not None, "an update says something")
        if kind == "outcome":
            self._take_outcome(update.outcome)
            return
        if kind == "opened":
            require(self.opened is None or self.is_resuming, "SessionOpened comes once, and once for each resume")
            if self.is_resuming:
                self._take_resumed(update.opened)
            else:
                self.next_frame = self.end = update.opened.start_frame
            self.opened, self.is_resuming = update.opened, False
            return
        require(not self.is_resuming, f"SessionOpened comes before {kind}")
        require(self.opened is not None, f"SessionOpened comes before {kind}")
        if kind == "plan":
            self._take_plan(update.plan)
        elif kind == "chunk":
            self._take_chunk(update.chunk)
        elif kind == "service_level":
            self.levels.append(update.service_level)
        elif kind == "constraint_reached":
            decided = update.constraint_reached.frame < self.committed_to or self.attempt > 0  # or told of again
            require(decided, "a constraint is told of when its frame is decided")
            self.reached.append(update.constraint_reached)
        else:
            self.closed = update.closed

    def _take_resumed(self, opened: session_pb2.SessionOpened) -> None:
        assert self.opened is not None
        require(opened.session_token == self.opened.session_token, "a session keeps its token")
        require(opened.session_id == self.opened.session_id, "a session keeps its name")
        require(opened.start_frame <= self.next_frame, "a session goes on no later than where its client is")
        self.goes_on_at = opened.start_frame

    def _take_outcome(self, outcome: session_pb2.EditOutcome) -> None:
        self.outcomes.append(outcome)
        if outcome.code == 0:
            require(not (outcome.reason or outcome.field or outcome.allowed), "an accepted event has no reason")
            told = all(warning.reason and warning.message for warning in outcome.warnings)
            require(told, "a warning says what of, for programs and for people")
            return
        require(not outcome.warnings, "a refused event is not warned of")
        require(bool(outcome.reason and outcome.message), "a refusal says why, for programs and for people")
        require(not outcome.HasField("effective_frame"), "a refused event is in effect nowhere")

    def _take_plan(self, plan: session_pb2.PlanNotice) -> None:
        require(plan.plan > (self.plans[-1].plan if self.plans else 0), "plan numbers rise")
        require(plan.valid_from >= self.committed_to, "valid_from is not below committed_to")
        if plan.cause == session_pb2.PLAN_CAUSE_CONTINUE:
            require(plan.valid_from >= self.next_frame, "a continuation replaces nothing")
        else:
            causes = (session_pb2.PLAN_CAUSE_EDIT, session_pb2.PLAN_CAUSE_RESUME)
            require(plan.cause in causes, "a plan has a cause")
            told = len(plan.event_seqs) > 0 or plan.cause == session_pb2.PLAN_CAUSE_RESUME
            require(told, "an edit's plan names its events")
        self.plans.append(plan)
        self.next_frame = min(self.next_frame, plan.valid_from)

    def _take_chunk(self, chunk: motion_pb2.FrameChunk) -> None:
        assert self.opened is not None
        require(bool(self.plans), "a PlanNotice precedes the first chunk")
        require(chunk.plan == self.plans[-1].plan, "a chunk is of the latest plan")
        require(chunk.first_frame == self.next_frame, "chunks neither leave out nor repeat a frame")
        require(chunk.frame_count >= 1, "a chunk holds a frame")
        require(len(chunk.data) == chunk.frame_count * self.row_bytes, "data is as long as its rows")
        require(bool(np.isfinite(np.frombuffer(chunk.data, "<f4")).all()), "frames are finite")
        require(chunk.scalar_type == self.opened.scalar_type, "the scalar type is the one agreed on")
        require(chunk.committed_to >= self.committed_to, "committed_to never falls")
        for row in range(chunk.frame_count):
            frame, data = chunk.first_frame + row, chunk.data[row * self.row_bytes : (row + 1) * self.row_bytes]
            known = self.frames.get(frame)
            require(known in (None, data) or frame >= self.committed_to, "a committed frame never changes")
            self.frames[frame] = data
        self.next_frame += chunk.frame_count
        require(self.next_frame <= self.playhead + self.opened.lookahead_frames, "no frame is sent beyond the credit")
        self.end = max(self.end, self.next_frame)
        self.committed_to = chunk.committed_to
        self.chunks.append(chunk)

    def outcome(self, event_seq: int) -> session_pb2.EditOutcome | None:
        """The answer to an event; fails where there are two, unless they are the same, told again to who resumed."""
        answers = [outcome for outcome in self.outcomes if outcome.event_seq == event_seq]
        same = all(answer == answers[0] for answer in answers)
        require(len(answers) <= 1 or (same and self.attempt > 0), "an event is answered once")
        return answers[0] if answers else None


class Talk:
    """One stream. Sessions are known by their handles; a handle that is opened again begins anew."""

    def __init__(self, stub: service_pb2_grpc.MotionServiceStub, catalog: service_pb2.GetCatalogResponse) -> None:
        self.catalog = catalog
        self.call = stub.StreamMotion()
        self.sessions: dict[int, Heard] = {}
        self.responses: list[service_pb2.StreamMotionResponse] = []
        self._reading: asyncio.Task[object] | None = None
        self._row_bytes = 4 * sum(block.width for block in catalog.rigs[0].blocks)

    # ---- saying -----------------------------------------------------------------------------------------------------

    async def hello(self) -> Talk:
        """Greet the server and wait for its greeting; updates are gathered for as short a time as may be."""
        hello = service_pb2.ClientHello(client_agent="compliance")
        hello.flush_interval.FromMilliseconds(5)
        await self.say(service_pb2.StreamMotionRequest(hello=hello))
        first = await self.hear()
        require(first.HasField("hello"), "the server's first message has hello")
        return self

    async def say(self, request: service_pb2.StreamMotionRequest) -> None:
        async with asyncio.timeout(LIMIT_S):
            await self.call.write(request)

    async def send(self, *events: session_pb2.SessionEvent) -> None:
        """Send events as they are."""
        await self.say(service_pb2.StreamMotionRequest(events=events))

    async def ask_open(self, handle: int, **fields: object) -> Heard:
        """Send an OpenSession on a handle that carries none."""
        heard = self.sessions[handle] = Heard(self._row_bytes)
        opening = session_pb2.OpenSession(**fields)  # type: ignore[arg-type]
        await self.send(session_pb2.SessionEvent(session=handle, event_seq=1, open=opening))
        return heard

    async def open(self, handle: int, **fields: object) -> Heard:
        """Open a session and wait for its first frames."""
        heard = await self.ask_open(handle, **fields)
        await self.until(lambda: heard.chunks or heard.outcomes)
        require(heard.opened is not None, f"the session opens: {heard.outcomes}")
        return heard

    async def ask_resume(self, handle: int, heard: Heard, **fields: object) -> None:
        """Send an OpenSession that resumes a session which another stream carried."""
        assert heard.opened is not None
        heard.attempt += 1
        heard.is_resuming = True
        self.sessions[handle] = heard
        point = session_pb2.ResumePoint(
            next_frame=heard.next_frame,
            plan=heard.plans[-1].plan if heard.plans else 0,
            answered_seq=heard.applied_seq,
            attempt=heard.attempt,
        )
        asked: dict[str, object] = {"resume_token": heard.opened.session_token, "resume_point": point} | fields
        opening = session_pb2.OpenSession(**asked)  # type: ignore[arg-type]
        await self.send(session_pb2.SessionEvent(session=handle, event_seq=1, open=opening))

    async def resume(self, handle: int, heard: Heard) -> None:
        """Resume a session, and wait until the server says so."""
        await self.ask_resume(handle, heard)
        await self.until(lambda: not heard.is_resuming or heard.outcome(1))
        require(not heard.is_resuming, f"the session is resumed: {heard.outcomes}")

    async def edit(self, handle: int, event: session_pb2.SessionEvent) -> session_pb2.EditOutcome:
        """Send the next event of a session and wait for its answer."""
        heard = self.sessions[handle]
        heard.sent_seq += 1
        await self.send(addressed(event, handle, heard.sent_seq))
        return await self.answer(handle, heard.sent_seq)

    async def answer(self, handle: int, event_seq: int) -> session_pb2.EditOutcome:
        heard = self.sessions[handle]
        await self.until(lambda: heard.outcome(event_seq) is not None)
        outcome = heard.outcome(event_seq)
        assert outcome is not None
        return outcome

    async def report(self, handle: int, frame: int) -> None:
        """Report the playhead; credit grows with it from here on."""
        heard = self.sessions[handle]
        heard.playhead = max(heard.playhead, frame)
        playhead = session_pb2.Playhead(frame=frame, buffered_to=heard.next_frame)
        await self.send(session_pb2.SessionEvent(session=handle, playhead=playhead))

    async def close(self, handle: int) -> session_pb2.SessionClosed:
        heard = self.sessions[handle]
        heard.sent_seq += 1
        await self.send(addressed(close(), handle, heard.sent_seq))
        await self.until(lambda: heard.closed is not None)
        assert heard.closed is not None
        return heard.closed

    async def ping(self, number: int) -> service_pb2.Pong:
        """Send a ping and wait for its answer."""
        await self.say(service_pb2.StreamMotionRequest(ping=service_pb2.Ping(client_time_ns=number)))
        while True:
            response = await self.hear()
            if response.HasField("pong"):
                return response.pong

    # ---- hearing ----------------------------------------------------------------------------------------------------

    async def hear(self) -> service_pb2.StreamMotionResponse:
        """The next message. Raises StreamOver at the end, and AioRpcError where that is not OK."""
        if not await self._has_come(LIMIT_S):
            raise TimeoutError(f"nothing came for {LIMIT_S:g} s")
        assert self._reading is not None
        reading, self._reading = self._reading, None
        response = reading.result()
        if not isinstance(response, service_pb2.StreamMotionResponse):
            raise StreamOver
        self.responses.append(response)
        for update in response.updates:
            if update.session not in self.sessions:
                self.sessions[update.session] = Heard(self._row_bytes)
            self.sessions[update.session].take(update)
        return response

    async def _has_come(self, limit_s: float) -> bool:
        """Whether the next message, or the end, is there before the time is over. A read is never broken off."""
        if self._reading is None:
            self._reading = asyncio.ensure_future(self.call.read())
        await asyncio.wait({self._reading}, timeout=limit_s)
        return self._reading.done()

    async def until(self, holds: Callable[[], object]) -> None:
        """Hear messages until something holds."""
        while not holds():
            await self.hear()

    async def to_the_end(self) -> grpc.StatusCode:
        """Hear all that is left; returns the status, OK or not."""
        try:
            while True:
                await self.hear()
        except StreamOver:
            return await self.call.code()
        except grpc.aio.AioRpcError as error:
            return error.code()

    async def plays_on(self, handle: int) -> None:
        """Play what a session has sent, and wait for more of it: who jumps ahead earns that in real time."""
        heard = self.sessions[handle]
        before = heard.end
        await self.report(handle, before - 1)
        async with asyncio.timeout(LIMIT_S):
            while heard.end == before and heard.closed is None:
                if await self._has_come(REPORT_PERIOD_S):
                    await self.hear()
                else:
                    await self.report(handle, before - 1)
        require(heard.closed is None, f"the session lives: {heard.closed}")


def addressed(event: session_pb2.SessionEvent, handle: int, event_seq: int) -> session_pb2.SessionEvent:
    """A copy of an event with its session and number."""
    copy = session_pb2.SessionEvent()
    copy.CopyFrom(event)
    copy.session, copy.event_seq = handle, event_seq
    return copy
