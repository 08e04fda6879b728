"""Conversation: what a session receives from the server: its opening, frames, answers, and its end."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence

from motiongen.v1 import session_pb2
from motiongen_client import convert
from motiongen_client.callbacks import call_back
from motiongen_client.carrier import Carrier
from motiongen_client.direction import PRESENT_PROMPT_ID
from motiongen_client.errors import EventRefused, MotiongenError, ProtocolViolation, SessionEnded, UnknownName
from motiongen_client.playback import Playback
from motiongen_client.prompts import Prompt
from motiongen_client.recovery import Recovery
from motiongen_client.reopening import Line
from motiongen_client.types import (
    Catalog,
    Constraint,
    ConstraintReached,
    ModelWarning,
    Opened,
    ServiceLevel,
    SessionEnd,
    SessionOptions,
    as_tuple,
    check_frame,
    check_number,
    check_type,
    check_whole,
)
from motiongen_client.types.checks import MOST_FRAME, MOST_UINT32

_log = logging.getLogger(__name__)
_WARNINGS_REMEMBERED = 16


class Conversation(Recovery):
    """The part of a `Session` that takes the server's updates."""

    service_level: ServiceLevel

    def __init__(self, handle: int, carrier: Carrier, catalog: Catalog, clock: Callable[[], float]) -> None:
        super().__init__(handle, carrier, catalog, clock)
        self._opened_at_s = clock()
        self._is_ahead = False  # frames consumed since the last report, ahead of the server's clock
        self._opening: asyncio.Future[Opened] = asyncio.get_running_loop().create_future()
        self._keep_s: float | None = None
        self._end: SessionEnd | None = None
        self._opened_s = 0.0
        self._first_frame_s: float | None = None
        self._num_plans = 0
        self._num_frames = 0
        self._logged: deque[str] = deque(maxlen=_WARNINGS_REMEMBERED)
        self.on_service_level: Callable[[ServiceLevel], None] | None = None
        self.on_constraint_reached: Callable[[ConstraintReached], None] | None = None

    # ---- for the stream

    async def begin(
        self,
        options: SessionOptions,
        prompt: Prompt | None,
        later_prompts: Mapping[int, Prompt],
        constraints: Sequence[Constraint],
        keep_s: float | None,
    ) -> None:
        """Open the session and wait for the answer. Raises the refusal, or why it can never be opened."""
        if keep_s is not None:  # checked here, as an error while the opening is heard would end the stream
            check_number("keep_s", keep_s, "seconds of 0 or more, or None to keep all", lambda s: 0 <= s <= MOST_FRAME)
        check_type("later_prompts", later_prompts, Mapping, "a mapping of frames to prompts, such as {40: 'a text'}")
        constraints = as_tuple("constraints", constraints, "several constraints, such as [Waypoint(...)]")
        self._options, self._keep_s = options, keep_s
        prompts = [] if prompt is None else [convert.prompt_span(PRESENT_PROMPT_ID, prompt, None)]
        for frame, text in later_prompts.items():
            check_frame("later_prompts", frame)
            prompts.append(convert.prompt_span(self._next_prompt_id, text, frame))
            self._scheduled_prompts[self._next_prompt_id] = frame
            self._next_prompt_id += 1
        ids = self._take_constraint_ids(len(constraints))
        targets = [convert.constraint(key, target) for key, target in zip(ids, constraints, strict=True)]
        opening = convert.open_session(options, prompts, targets)
        if (refusal := self._refusal("opening a session")) is not None:
            raise refusal
        self._wishes.take_opening(opening)
        self._send(session_pb2.SessionEvent(open=opening))
        await asyncio.shield(self._opening)

    def abandon(self) -> None:
        """End a session whose opening nobody awaits any more, here and on the server."""
        if self._failure is not None:
            return
        if self._carrier.is_connected:
            self._send(session_pb2.SessionEvent(close=session_pb2.CloseSession()))
        else:
            self._finish(SessionEnd("client", "it was given up before it was opened", self._num_frames, 0))

    async def constraint_reached(self, constraint_id: int) -> ConstraintReached:
        """What became of a constraint, by an id of `Edit.constraint_ids`, once its last frame can no longer change.

        Raises EventRefused if it was refused or its frames passed while the connection was lost. If the session ends
        first, raises what ended it; for a constraint that was removed, it waits for that. The last 256 outcomes and the
        last 256 refusals are kept; raises InvalidInput for an earlier one.
        """
        check_whole("constraint_id", constraint_id, "one of the constraint_ids of an earlier Edit", least=1)
        return await self._reached.of(constraint_id)

    @property
    def _is_closing(self) -> bool:
        """Whether it was asked to close, and has not been answered."""
        return any(event.HasField("close") for event in self._unanswered)

    @property
    def is_over(self) -> bool:
        """Whether nothing more will be sent or received."""
        return self._failure is not None

    @property
    def is_reporting(self) -> bool:
        """Whether to report the playhead: after a reopening, not before it reaches the new session's first frame.

        A playhead that stands still is reported even then, or the server would close the session as idle. From then on
        the server counts from there, so reports continue.
        """
        if self._line is not Line.OPEN or self._failure is not None:
            return False
        stands = not self.playback.started or not self.playback.is_playing
        return stands or self._has_reported or self.playback.playhead >= self._offset

    def report(self) -> session_pb2.SessionEvent:
        """Where the playhead is, and which answers have come."""
        playback, offset = self.playback, self._offset
        self._has_reported, self._is_ahead = True, False
        report = session_pb2.Playhead(
            frame=max(playback.playhead - offset, 0),
            buffered_to=max(playback.buffered_to - offset, 0),
            underruns=min(playback.underruns, MOST_UINT32),
            answered_seq=self._answered_seq,
        )
        return session_pb2.SessionEvent(session=self.handle, playhead=report)

    def _transmit(self, event: session_pb2.SessionEvent) -> None:
        if self._is_ahead and self.is_reporting:  # or the event would replace frames that were consumed
            self._carrier.send(self.report())
        super()._transmit(event)

    def interrupt(self) -> None:
        """The connection is lost. A session that was being closed is over."""
        if self._is_closing:
            self._finish(SessionEnd("client", "the connection was lost while it was being closed", self._num_frames, 0))
            return
        super().interrupt()

    def hear(self, update: session_pb2.SessionUpdate) -> None:
        """Take one update from the server. Raises ProtocolViolation if it breaks a rule."""
        kind = update.WhichOneof("update")
        if kind in ("plan", "chunk") and self._line is not Line.OPEN:
            raise ProtocolViolation(f"a {kind} came before the session was opened")
        if kind == "service_level" and self._line is Line.OPENING:
            raise ProtocolViolation("a service level came before the session was opened")
        match kind:
            case "opened":
                self._hear_opened(convert.opened(update.opened, self._offset), convert.session_token(update.opened))
            case "plan":
                valid_from = convert.frame(update.plan.valid_from, self._offset)
                is_cut = update.plan.cause == session_pb2.PLAN_CAUSE_CUT
                self.playback.announce_plan(update.plan.plan, valid_from, is_cut=is_cut)
                self._num_plans += 1
                self._edits.plan(update.plan.event_seqs, valid_from)
            case "chunk":
                chunk, offset = update.chunk, self._offset
                self._reached.end_replay()
                first = convert.frame(chunk.first_frame, offset)
                held = self.playback.held_rows(first - 1, first)
                rows = self._reader.rows(chunk, held[0] if held else None)
                self.playback.add_chunk(chunk.plan, first, rows, convert.frame(chunk.committed_to, offset))
                self._patience.reset()
                self._note_frames(len(rows), first + len(rows))
            case "outcome":
                self._hear_outcome(update.outcome)
            case "constraint_reached":
                reached = convert.constraint_reached(update.constraint_reached, self._offset)
                key = reached.constraint_id
                is_former = self._wishes.excludes(key, reached.frame, self._reached.replaced_from(key))
                if self._reached.note(reached, is_former=is_former):
                    if not is_former:
                        self._wishes.end(key)
                    call_back(self.on_constraint_reached, reached)
            case "durability":
                self.durable_seq = max(update.durable_seq, self.durable_seq)
                self._set_durable(update.durability.is_kept)
            case "service_level":
                self._set_level(convert.service_level(update.service_level))
            case "closed":
                self._hear_closed(update.closed)
        self._changed.set()

    def fail(self, failure: MotiongenError) -> None:
        super().fail(failure)
        self._reached.fail(failure)
        if not self._opening.done():
            self._opening.set_exception(failure)
            self._opening.exception()

    # ---- updates of an open session

    def _hear_opened(self, opened: Opened, token: str) -> None:
        if self._line is not Line.OPENING:
            self._hear_reopened(opened, token)
            self._set_level(ServiceLevel("full", opened.denoise_steps))  # another follows if the level is lower
            return
        self._line, self.opened, self._token = Line.OPEN, opened, token
        self._unanswered.pop(1)
        self._log_warnings(opened.warnings)
        self._wishes.place(opened.placements)
        self.service_level = ServiceLevel("full", opened.denoise_steps)
        try:
            rig = self._catalog.rig(opened.rig_id)
        except UnknownName as unknown:
            raise ProtocolViolation(f"a session was opened on a rig the catalogue does not have: {unknown}") from None
        convert.check_outputs(opened.outputs, self._options.outputs, rig)
        self.rig = rig.with_outputs(opened.outputs)
        self.playback = Playback(
            self.rig.frame_rate_hz,
            self.rig.row_width,
            start_frame=opened.start_frame,
            keep_frames=None if self._keep_s is None else self.rig.frames_in(self._keep_s),
        )
        self._reader = convert.FrameReader(self.rig, self._options.frame_format)
        self._opened_s = self._clock() - self._opened_at_s
        if not self._opening.done():
            self._opening.set_result(opened)

    def _set_level(self, level: ServiceLevel) -> None:
        if level != self.service_level:
            self.service_level = level
            call_back(self.on_service_level, level)

    def _hear_outcome(self, message: session_pb2.EditOutcome) -> None:
        if message.event_seq == 1 and self._line is not Line.OPEN:
            refusal = convert.outcome(message, "opening a session")
            if isinstance(refusal, EventRefused):
                self._hear_refused_opening(refusal)
            return
        if self.is_away:
            return  # it crossed the session's end: what is unanswered by then is sent again when it continues
        event = self._unanswered.pop(message.event_seq)
        edit = self._edits.find(message.event_seq)
        answer = convert.outcome(message, edit.what if edit is not None else "an event", self._offset)
        if isinstance(answer, EventRefused):
            if edit is None or not edit.is_awaited:
                _log.warning("session %d: %s", self.handle, answer)
        else:
            self._log_warnings(answer.warnings)
            if event is not None:
                playhead = self.playback.playhead
                effective = playhead if answer.effective_frame is None else answer.effective_frame
                if event.HasField("seek") and answer.effective_frame is not None:
                    effective = self.playback.note_cut(effective)
                self._wishes.take(event, effective, playhead, answer.placements)
            if edit is not None and edit.is_replacement:
                key, effective_frame = edit.constraint_ids[0], answer.effective_frame
                self._reached.replaced(key, is_accepted=True, effective_frame=effective_frame)
        if edit is not None:
            self._edits.answer(edit, answer)

    def _hear_closed(self, message: session_pb2.SessionClosed) -> None:
        end = convert.session_end(message)
        is_lost = end.reason == "drained" or convert.code_name(message.code) == "UNAVAILABLE"
        if is_lost and self._carrier.recovers and self._line is not Line.OPENING:
            self._lose(f"the server ended it ({end.reason})")
        else:
            self._finish(end)

    def _finish(self, end: SessionEnd) -> None:
        self._end = end
        self.fail(SessionEnded(end.reason, end.message))

    def _log_warnings(self, warnings: Iterable[ModelWarning]) -> None:
        """Log the warnings not logged recently: while a stick is held, the same one comes ten times a second."""
        for each in warnings:
            if each.message not in self._logged:
                self._logged.append(each.message)
                _log.warning("session %d: %s", self.handle, each.message)

    def _note_frames(self, num_frames: int, end_frame: int) -> None:
        now_s = self._clock()
        self._num_frames += num_frames
        if self._first_frame_s is None:
            self._first_frame_s = now_s - self._opened_at_s
        self._edits.receive(end_frame, now_s)
