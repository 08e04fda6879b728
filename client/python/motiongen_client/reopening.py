"""Reopening: how a session is opened anew if no server can resume it.

The last frames held become the new session's history, its frame 0 is the frame after them, and it is sent everything
that the old session had been told and that still applies.
"""

from __future__ import annotations

import enum
import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from motiongen.v1 import session_pb2
from motiongen_client import convert
from motiongen_client.callbacks import call_back
from motiongen_client.carrier import Carrier
from motiongen_client.direction import PRESENT_PROMPT_ID, Direction
from motiongen_client.edit import LOST_MEANWHILE, Edit
from motiongen_client.errors import EventRefused, InvalidInput, MotiongenError, SessionEnded, UnknownName
from motiongen_client.frame_shift import passed_targets, shifted
from motiongen_client.motion import Motion
from motiongen_client.types import Catalog, Opened, Priority, Reopened, SessionOptions, StartPose, as_tuple
from motiongen_client.wishes import Wishes

_log = logging.getLogger(__name__)
MOST_REOPENINGS = 256
"""Limit on the reopenings that are remembered: where no server keeps a session for long, there is no end of them."""
_AROUND_ROWS_BYTES = 64  # tags, lengths and numbers of the messages around rows


class Line(enum.Enum):
    """The state of a session's connection. OPENING, REOPENING and RESUMING wait for a SessionOpened."""

    OPENING = enum.auto()
    OPEN = enum.auto()
    LOST = enum.auto()
    RESUMING = enum.auto()
    REOPENING = enum.auto()


class Reopening(Direction):
    """The part of a `Session` that knows how it was opened, and opens it anew.

    reopenings: one entry for each time that the session was opened anew, of the last 256; `on_reopened`, if set, is
    called with it.
    is_durable: whether its server saves it, so that another can continue it; `on_durability`, if set, is called when
    that changes. durable_seq: events up to this number survive the loss of the server.
    """

    opened: Opened

    def __init__(self, handle: int, carrier: Carrier, catalog: Catalog, clock: Callable[[], float]) -> None:
        super().__init__(handle, carrier, clock)
        self._catalog = catalog
        self._options = SessionOptions()
        self._line = Line.OPENING
        self._token = ""
        self._attempt = 0
        self._reason = ""
        self._has_reported = False  # of the present session on the server
        self.is_durable = False
        self.durable_seq = 0
        self.on_durability: Callable[[bool], None] | None = None
        self._wishes = Wishes()
        self.reopenings: tuple[Reopened, ...] = ()
        self._num_reopenings = 0
        self.on_reopened: Callable[[Reopened], None] | None = None

    def fail(self, failure: MotiongenError) -> None:
        """The session is over: nothing more will be answered."""
        if self._failure is None:
            self._failure = failure
        self._repeating.stop()
        self._unanswered.clear()
        self._edits.fail(failure)
        self._changed.set()

    def set_options(
        self,
        *,
        priority: Priority | None = None,
        lookahead_frames: int | None = None,
        denoise_steps: int | None = None,
        guidance: tuple[float | None, float | None] | None = None,
        history_frames: int | None = None,
    ) -> Edit:
        """Change options of the session, from the next window on; None leaves one as it is.

        guidance: the weights of text and of constraints, set together; None within the pair means the model's own. The
        server may refuse options that need more than its free capacity. A session that is opened anew has the options
        accepted last.
        """
        counts = {
            "lookahead_frames": lookahead_frames,
            "denoise_steps": denoise_steps,
            "history_frames": history_frames,
        }
        given: dict[str, Any] = {name: count for name, count in counts.items() if count is not None}
        if priority is not None:
            given["priority"] = priority
        if guidance is not None:
            allowed = "a pair: the weights of text and of constraints"
            guidance = as_tuple("guidance", guidance, allowed)  # type: ignore[assignment]
            if len(guidance) != 2:
                raise InvalidInput("guidance", guidance, allowed)
            given["text_guidance"], given["constraint_guidance"] = guidance
        replace(self._options, **given)  # raises InvalidInput if one is invalid
        message = convert.set_options(priority, lookahead_frames, denoise_steps, guidance, history_frames)
        sent = self._send_edit("the change of options", session_pb2.SessionEvent(set_options=message))
        # Applied to the options of that moment, since others may have been accepted by then.
        sent.when_accepted(lambda: setattr(self, "_options", replace(self._options, **given)))
        return sent

    # ---- for Recovery

    def _reopen(self, reason: str) -> None:
        """Open a new session that continues from the last frame held."""
        self._line, self._token, self._attempt, self._reason = Line.REOPENING, "", 0, reason
        self.durable_seq = 0
        self._has_reported = False
        self._set_durable(False)
        frame = self.playback.buffered_to
        options = replace(self._options, seed=self.opened.seed, model_id=self.opened.model_id)
        prompts = self._wishes.prompts_from(frame, self._catalog.limits.max_prompts)
        constraints = self._wishes.constraints_from(frame)
        if frame > self.playback.first_kept:
            options = replace(options, prior=None, start=StartPose())
            rest_bytes = convert.open_session(options, prompts, constraints).ByteSize()
            options = replace(options, prior=self._prior(frame, rest_bytes))
        self.playback.restart(frame)
        self._offset = frame
        lasting = [span for span in prompts if span.prompt_id != PRESENT_PROMPT_ID and not span.end_frame]
        changing = self._prompts_without_answer()  # already dropped for the unanswered edits, which are sent after this
        self._scheduled_prompts = {
            span.prompt_id: span.start_frame + frame for span in lasting if span.prompt_id not in changing
        }
        self._send_opening(convert.open_session(options, prompts, constraints))

    def _prompts_without_answer(self) -> set[int]:
        """The ids of prompts that unanswered edits remove or set."""
        edits = [event.edit_prompts for event in self._unanswered]
        return {key for edit in edits for key in (*edit.remove, *(span.prompt_id for span in edit.upsert))}

    def _prior(self, end_frame: int, rest_bytes: int = 0) -> Motion:
        """The last frames before end_frame, as many as a window sees. If fewer are held, the first is repeated.

        rest_bytes: the size of the rest of the message.
        """
        try:
            model = self._catalog.model(self.opened.model_id)
        except UnknownName:
            wanted = 1  # the server will refuse it
        else:
            patch = max(model.patch_frames, 1)
            asked = self._options.history_frames or model.default_history_frames
            most_bytes = self._catalog.limits.max_request_bytes * 9 // 10 - rest_bytes - _AROUND_ROWS_BYTES
            most = max(most_bytes // (4 * self.rig.own_width), 1)
            wanted = min(max(min(asked, most) // patch, 1) * patch, most)  # limited by what fits in a message
        first = max(end_frame - wanted, self.playback.first_kept, self.playback.cut_before(end_frame) or 0)
        rows = self.playback.rows(first, end_frame)
        missing = wanted - len(rows)
        if missing > 0:
            rows = np.concatenate((np.repeat(rows[:1], missing, axis=0), rows))
        return Motion(self.rig, end_frame - wanted, rows)

    def _send_opening(self, opening: session_pb2.OpenSession) -> None:
        event = session_pb2.SessionEvent(session=self.handle, event_seq=1, open=opening)
        if (misfit := self._misfit(event)) is None:
            self._carrier.send(event)
        else:
            self._break_off(misfit)

    def _send_unanswered(self) -> None:
        """Send unanswered events again, under the same numbers; the server ignores those it has already accepted."""
        for event in self._unanswered:
            if (misfit := self._misfit(event)) is not None:
                self._break_off(misfit, event.event_seq)
                return
        self._repeating.begin(self._catalog.limits.max_events_per_second)

    def _misfit(self, event: session_pb2.SessionEvent) -> InvalidInput | None:
        """Why an event does not fit in a message, if so: the server would end the whole stream."""
        try:
            self._carrier.check(event)
        except InvalidInput as too_big:
            return too_big
        return None

    def _break_off(self, failure: MotiongenError, number: int | None = None) -> None:
        """End the session here, and on the server if that has it.

        number: that of the first unanswered event that cannot be sent; None if all were sent. The close takes it, after
        the events before: the server may have received a lower number, and a higher one would be a gap.
        """
        if self._line is Line.OPEN:
            number = self._next_seq if number is None else number
            for event in self._unanswered:
                if event.event_seq < number:
                    self._transmit(event)
            close = session_pb2.CloseSession()
            self._carrier.send(session_pb2.SessionEvent(session=self.handle, event_seq=number, close=close))
        self.fail(failure)

    def _set_durable(self, is_durable: bool) -> None:
        if is_durable != self.is_durable:
            self.is_durable = is_durable
            call_back(self.on_durability, is_durable)

    def _go_on_anew(self, opened: Opened) -> None:
        self._line, self._next_seq, self._said_to = Line.OPEN, 2, 1
        known = {rig.rig_id: rig.own_width for rig in self._catalog.rigs}
        is_same = opened.rig_id == self.opened.rig_id and opened.outputs == self.opened.outputs
        if not is_same or known.get(opened.rig_id) != self.rig.own_width:
            self._unanswered.clear()
            self._break_off(SessionEnded("model_unloaded", f"its rig, {self.opened.rig_id}, is not served any more"))
            return
        self.opened = opened
        wished = self._wishes.events_from(self._offset)
        held = [event for event in self._unanswered.take_all() if self._is_asked(event)]
        numbers = {}
        passed = EventRefused("a constraint", "FAILED_PRECONDITION", "FRAME_COMMITTED", LOST_MEANWHILE)
        for event in (*wished, *held):
            self._say_as_frames(event)
            if shifted(event, self._offset) is None:
                continue
            self._reached.refuse(passed_targets(event, self._offset), passed)
            numbers[event.event_seq] = self._next_seq
            event.session, event.event_seq = self.handle, self._next_seq
            self._unanswered.add(event)
            self._next_seq += 1
        self._edits.renumber(numbers)
        for key in self._wishes.passed_at(self._offset):
            self._reached.refuse([key], passed)
            self._wishes.end(key)
        self._wishes.take_reopening(self._offset, opened.placements)
        self._send_unanswered()
        if self._failure is not None:
            return
        told = Reopened(self._offset, self._reason)
        self.reopenings = (*self.reopenings[1 - MOST_REOPENINGS :], told)
        self._num_reopenings += 1
        _log.warning("session %d was opened anew at frame %d: %s", self.handle, told.frame, told.reason)
        call_back(self.on_reopened, told)

    def _expects(self, constraint_id: int) -> bool:
        """Whether the constraint with this id is being set, or was accepted and is not over."""
        being_set = (target for event in self._unanswered for target in event.edit_constraints.upsert)
        return self._wishes.holds(constraint_id) or any(each.constraint_id == constraint_id for each in being_set)

    def _is_asked(self, event: session_pb2.SessionEvent) -> bool:
        """Whether an application asked for the event, as opposed to wishes sent again at the last reopening."""
        return event.HasField("close") or self._edits.find(event.event_seq) is not None
