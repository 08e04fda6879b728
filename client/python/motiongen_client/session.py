"""One character: its opening, its frames, its end. Lives on a `Stream`; all of it runs on one event loop."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncGenerator, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from motiongen.v1 import session_pb2
from motiongen_client import convert
from motiongen_client.direction import PRESENT_PROMPT_ID, Carrier, Direction
from motiongen_client.errors import EventRefused, MotiongenError, ProtocolViolation, SessionEnded, UnknownName
from motiongen_client.motion import Frame, Motion
from motiongen_client.playback import Playback
from motiongen_client.prompts import Prompt
from motiongen_client.reached import ReachedBook
from motiongen_client.types import (
    Catalog,
    Constraint,
    ConstraintReached,
    ModelWarning,
    Opened,
    ServiceLevel,
    SessionEnd,
    SessionOptions,
    check_frame,
)

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SessionStats:
    """Counts and times of one session so far.

    opened_s, first_frame_s: from the call of `open` to the server's answer and to the first frame, seconds.
    plans: windows received, replans among them; frames: frames received, replaced ones too.
    underruns: frame times for which the last pose had to be held; late_plans: plans that reached behind the playhead.
    """

    opened_s: float
    first_frame_s: float | None
    plans: int
    frames: int
    underruns: int
    late_plans: int


class Session(Direction):
    """One character. Made by `Stream.open`; not made by hand.

    Changes (`set_prompt`, `add_waypoint`, …) are sent at once, in order, and return an `Edit`. Frames come by
    `frames()`, or by `poll()` for a loop that draws at its own pace; use one of the two.

    service_level: how well the server serves it at present; `on_service_level`, if set, is called at each change.
    `on_constraint_reached`, if set, is called for each constraint whose last frame cannot change any more.
    """

    def __init__(self, handle: int, carrier: Carrier, catalog: Catalog, clock: Callable[[], float]) -> None:
        super().__init__(handle, carrier, clock)
        self._catalog = catalog
        self._opened_at_s = clock()
        self._opening: asyncio.Future[Opened] = asyncio.get_running_loop().create_future()
        self._keep_s: float | None = None
        self._end: SessionEnd | None = None
        self._opened_s = 0.0
        self._first_frame_s: float | None = None
        self._num_plans = 0
        self._num_frames = 0
        self._untold = range(0)  # frames that the playhead has reached, but `frames` has not given yet
        self.opened: Opened
        self.service_level: ServiceLevel
        self.on_service_level: Callable[[ServiceLevel], None] | None = None
        self.on_constraint_reached: Callable[[ConstraintReached], None] | None = None
        self._reached = ReachedBook()

    # ---- the end

    async def close(self) -> SessionEnd:
        """End the session. Returns how it ended; calling it again returns the same."""
        if self._end is None and self._failure is None:
            self._send(session_pb2.SessionEvent(close=session_pb2.CloseSession()))
        while self._end is None:
            if self._failure is not None:
                raise self._failure
            self._changed.clear()
            await self._changed.wait()
        return self._end

    async def __aenter__(self) -> Session:
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._failure is None:
            await self.close()

    # ---- constraints

    async def constraint_reached(self, constraint_id: int) -> ConstraintReached:
        """What became of a constraint, by an id of `Edit.constraint_ids`, once its last frame cannot change any more.

        Raises SessionEnded or StreamLost where the session ends before; one that is removed is waited for until then.
        """
        return await self._reached.of(constraint_id)

    # ---- frames

    @property
    def end(self) -> SessionEnd | None:
        """How the session ended; None while it lives."""
        return self._end

    @property
    def is_playing(self) -> bool:
        """Whether a frame has been shown; before that there is no playhead to report."""
        return self._opening.done() and self._failure is None and self.playback.started

    @property
    def stats(self) -> SessionStats:
        """Counts and times so far."""
        return SessionStats(
            opened_s=self._opened_s,
            first_frame_s=self._first_frame_s,
            plans=self._num_plans,
            frames=self._num_frames,
            underruns=self.playback.underruns,
            late_plans=self.playback.late_plans,
        )

    def frame_in(self, seconds: float) -> int:
        """The frame that is shown `seconds` from now."""
        return self.playback.playhead + self.rig.frames_in(seconds)

    async def frames(self, seconds: float | None = None, *, realtime: bool = True) -> AsyncGenerator[Frame, None]:
        """Each frame once, in order: the next `seconds` of motion, or without it until the session is closed.

        realtime: a frame comes when its time has come, and the last pose is held (nothing comes, `stats.underruns`
        rises) while the server is late. Otherwise frames come as fast as they are generated and taken.
        One that is left early, or has come to its end, is gone on from by the next, without a gap.
        Raises SessionEnded when the server ends the session, StreamLost when the stream breaks.
        """
        num_left = None if seconds is None else self.rig.frames_in(seconds)
        while num_left is None or num_left > 0:
            self._changed.clear()
            if self._is_over():
                return
            if not self._untold:
                self._untold = self._advance() if realtime else self._step()
            is_told_some = bool(self._untold)
            while self._untold:
                index, self._untold = self._untold[0], self._untold[1:]
                yield Frame(self.rig, index, self.playback.row(index))
                if num_left is not None:
                    num_left -= 1
                    if num_left == 0:
                        return
            if realtime or not is_told_some:
                await self._wait(realtime)

    def poll(self) -> Frame | None:
        """Move the playhead to the present and return the frame to show now; None before the first one came.

        For a loop that draws at its own pace. Raises SessionEnded or StreamLost once no frame is left to show.
        """
        if not self._is_over():
            self._advance()
            self._untold = range(0)
        if not self.playback.started:
            return None
        return Frame(self.rig, self.playback.playhead, self.playback.row(self.playback.playhead))

    def motion(self, first_frame: int | None = None, end_frame: int | None = None) -> Motion:
        """The frames shown so far that are still kept, or those from first_frame up to end_frame - 1."""
        first = self.playback.first_kept if first_frame is None else first_frame
        shown_to = self.playback.playhead + 1 if self.playback.started else self.playback.playhead
        rows = self.playback.rows(first, shown_to if end_frame is None else end_frame)
        return Motion(self.rig, first, rows)

    def _advance(self) -> range:
        was_started = self.playback.started
        reached = self.playback.advance(self._clock())
        if reached and not was_started:
            self._carrier.report_soon()  # the server's idea of our clock begins here
        return reached

    def _step(self) -> range:
        playback = self.playback
        target = playback.playhead + 1 if playback.started else playback.playhead
        if target >= playback.buffered_to:
            return range(0)
        reached = playback.advance_to(target)
        if target + 1 == playback.buffered_to:
            self._carrier.report_soon()  # nothing left to take: more credit at once
        return reached

    def _is_over(self) -> bool:
        """Whether the session was closed by its user. Raises when it is over otherwise and no frame is left."""
        if self._end is not None and self._end.reason == "client":
            return True
        if self._failure is None:
            return False
        nothing_left = not self._untold and self.playback.playhead >= self.playback.buffered_to - 1
        if nothing_left:
            raise self._failure
        return False

    async def _wait(self, realtime: bool) -> None:
        """Until the next frame is due, or for something to arrive where it is overdue or no clock runs."""
        due_s = self.playback.next_due_s() if realtime else None
        if due_s is None:
            await self._changed.wait()
            return
        wait_s = due_s - self._clock()
        if wait_s > 0 or self.playback.buffered_to > self.playback.playhead + 1:
            await asyncio.sleep(max(wait_s, 0.0))  # whoever takes frames late gets the next at once
            return
        try:
            async with asyncio.timeout(1 / self.rig.frame_rate_hz):
                await self._changed.wait()
        except TimeoutError:
            pass  # one more frame time without a frame; `advance` counts it

    # ---- for the stream

    async def _open(
        self,
        options: SessionOptions,
        prompt: Prompt | None,
        later_prompts: Mapping[int, Prompt],
        constraints: Sequence[Constraint],
        keep_s: float | None,
    ) -> None:
        self._keep_s = keep_s
        prompts = [] if prompt is None else [convert.prompt_span(PRESENT_PROMPT_ID, prompt, None)]
        for frame, text in later_prompts.items():
            check_frame("later_prompts", frame)
            prompts.append(convert.prompt_span(self._next_prompt_id, text, frame))
            self._scheduled_prompts[self._next_prompt_id] = frame
            self._next_prompt_id += 1
        ids = self._take_constraint_ids(len(constraints))
        targets = [convert.constraint(key, target) for key, target in zip(ids, constraints, strict=True)]
        self._send(session_pb2.SessionEvent(open=convert.open_session(options, prompts, targets)))
        await asyncio.shield(self._opening)

    def _handle(self, update: session_pb2.SessionUpdate) -> None:
        """Take one update of the server. Raises ProtocolViolation when it breaks a rule."""
        kind = update.WhichOneof("update")
        if kind in ("plan", "chunk") and not self._opening.done():
            raise ProtocolViolation(f"a {kind} came before the session was opened")
        match kind:
            case "opened":
                self._handle_opened(convert.opened(update.opened))
            case "plan":
                self.playback.announce_plan(update.plan.plan, update.plan.valid_from)
                self._num_plans += 1
                self._edits.plan(update.plan.event_seqs, update.plan.valid_from)
            case "chunk":
                chunk = update.chunk
                rows = convert.chunk_rows(chunk, self.rig.row_width)
                self.playback.add_chunk(chunk.plan, chunk.first_frame, rows, chunk.committed_to)
                self._note_frames(len(rows), chunk.first_frame + len(rows))
            case "outcome":
                self._handle_outcome(update.outcome)
            case "constraint_reached":
                reached = convert.constraint_reached(update.constraint_reached)
                if self._reached.note(reached) and self.on_constraint_reached is not None:
                    self.on_constraint_reached(reached)
            case "service_level":
                self._handle_level(convert.service_level(update.service_level))
            case "closed":
                self._end = convert.session_end(update.closed)
                self._fail(SessionEnded(self._end.reason, self._end.message))
        self._changed.set()

    def _handle_opened(self, opened: Opened) -> None:
        self.opened = opened
        self._log_warnings(opened.warnings)
        self.service_level = ServiceLevel("full", opened.denoise_steps)
        try:
            self.rig = self._catalog.rig(opened.rig_id)
        except UnknownName as unknown:
            raise ProtocolViolation(f"a session was opened on a rig the catalogue does not have: {unknown}") from None
        self.playback = Playback(
            self.rig.frame_rate_hz,
            self.rig.row_width,
            start_frame=opened.start_frame,
            keep_frames=None if self._keep_s is None else self.rig.frames_in(self._keep_s),
        )
        self._opened_s = self._clock() - self._opened_at_s
        if not self._opening.done():
            self._opening.set_result(opened)

    def _handle_level(self, level: ServiceLevel) -> None:
        self.service_level = level
        if self.on_service_level is not None:
            self.on_service_level(level)

    def _handle_outcome(self, message: session_pb2.EditOutcome) -> None:
        if message.event_seq == 1 and not self._opening.done():
            refusal = convert.outcome(message, "opening a session")
            if isinstance(refusal, EventRefused):
                self._fail(refusal)
            return
        edit = self._edits.find(message.event_seq)
        if edit is None:
            return
        answer = convert.outcome(message, edit.what)
        if isinstance(answer, EventRefused):
            _log.warning("session %d: %s", self.handle, answer)
        else:
            self._log_warnings(answer.warnings)
        self._edits.answer(edit, answer)

    def _log_warnings(self, warnings: Iterable[ModelWarning]) -> None:
        for each in warnings:
            _log.warning("session %d: %s", self.handle, each.message)

    def _note_frames(self, num_frames: int, end_frame: int) -> None:
        now_s = self._clock()
        self._num_frames += num_frames
        if self._first_frame_s is None:
            self._first_frame_s = now_s - self._opened_at_s
        self._edits.receive(end_frame, now_s)

    def _fail(self, failure: MotiongenError) -> None:
        """The session is over: nothing more will be answered."""
        if self._failure is None:
            self._failure = failure
        self._edits.fail(failure)
        self._reached.fail(failure)
        if not self._opening.done():
            self._opening.set_exception(failure)
            self._opening.exception()
        self._changed.set()

    def _playhead(self) -> session_pb2.SessionEvent:
        playback = self.playback
        report = session_pb2.Playhead(
            frame=playback.playhead, buffered_to=playback.buffered_to, underruns=playback.underruns
        )
        return session_pb2.SessionEvent(session=self.handle, playhead=report)
