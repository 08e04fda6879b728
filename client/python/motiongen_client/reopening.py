"""How a session is opened anew where the server that had it cannot go on with it.

The last frames held are the new session's history, its frame 0 is the next of ours, and it is told all that the old one
had been told.
"""

from __future__ import annotations

import enum
import logging
from collections.abc import Callable, Iterable
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
from motiongen_client.types import Catalog, Opened, Priority, Reopened, SessionOptions, StartPose
from motiongen_client.wishes import Wishes

_log = logging.getLogger(__name__)


class Line(enum.Enum):
    """Whether a session and the server hear each other. OPENING, REOPENING and RESUMING wait for a SessionOpened."""

    OPENING = enum.auto()
    OPEN = enum.auto()
    LOST = enum.auto()
    RESUMING = enum.auto()
    REOPENING = enum.auto()


class Reopening(Direction):
    """The part of a `Session` that knows how it was opened, and opens it anew.

    reopenings: each time that the session could not be resumed and was opened anew; `on_reopened` is called then.
    is_durable: whether its server saves it, so that another can go on with it; `on_durability`, if set, is called when
    that changes. durable_seq: the last of its events that outlives the server.
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
        """Change what the session was opened with, from the next window on; None leaves it.

        guidance: of text and of constraints, both set anew, None within it for the model's own. The server may refuse
        more than there is room for. A session that is opened anew after a loss has what was accepted last.
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
            given["text_guidance"], given["constraint_guidance"] = guidance
        replace(self._options, **given)  # raises InvalidInput where one has no meaning
        message = convert.set_options(priority, lookahead_frames, denoise_steps, guidance, history_frames)
        sent = self._send_edit("the options", session_pb2.SessionEvent(set_options=message))
        # Others may have been accepted by then: to those of that moment.
        sent.when_accepted(lambda: setattr(self, "_options", replace(self._options, **given)))
        return sent

    # ---- for its recovery

    def _reopen(self, reason: str) -> None:
        """Open a session that goes on from the last frame that is held."""
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
        changing = self._prompts_without_answer()  # gone already for what is asked now, which is said behind it
        self._scheduled_prompts = {
            span.prompt_id: span.start_frame + frame for span in lasting if span.prompt_id not in changing
        }
        self._send_opening(convert.open_session(options, prompts, constraints))

    def _prompts_without_answer(self) -> set[int]:
        """The ids of prompts that edits without an answer drop or set anew."""
        edits = [event.edit_prompts for event in self._unanswered]
        return {key for edit in edits for key in (*edit.remove, *(span.prompt_id for span in edit.upsert))}

    def _prior(self, end_frame: int, rest_bytes: int = 0) -> Motion:
        """The last frames held, as many as a window sees; where there are fewer, the first is repeated before them.

        rest_bytes: what their message has besides.
        """
        try:
            model = self._catalog.model(self.opened.model_id)
        except UnknownName:
            wanted = 1  # the server will say so
        else:
            patch = max(model.patch_frames, 1)
            asked = self._options.history_frames or model.default_history_frames
            most_bytes = self._catalog.limits.max_request_bytes * 9 // 10 - rest_bytes
            most = max(most_bytes // (4 * self.rig.own_width), 1)
            wanted = min(max(min(asked, most) // patch, 1) * patch, most)  # in a message that the server takes
        first = max(end_frame - wanted, self.playback.first_kept, self.playback.cut_before(end_frame) or 0)
        rows = self.playback.rows(first, end_frame)
        missing = wanted - len(rows)
        if missing > 0:
            rows = np.concatenate((np.repeat(rows[:1], missing, axis=0), rows))
        return Motion(self.rig, end_frame - wanted, rows)

    def _send_opening(self, opening: session_pb2.OpenSession) -> None:
        event = session_pb2.SessionEvent(session=self.handle, event_seq=1, open=opening)
        if self._fits([event]):
            self._carrier.send(event)

    def _send_unanswered(self) -> None:
        """Say again what was not answered, with the numbers it has; the server drops what it has taken already."""
        if self._fits(self._unanswered):
            self._repeating.begin(self._catalog.limits.max_events_per_second)

    def _fits(self, events: Iterable[session_pb2.SessionEvent]) -> bool:
        """Whether the server takes messages of this size; else the session ends: the stream would, with all others."""
        try:
            for event in events:
                self._carrier.check(event)
        except InvalidInput as too_big:
            self._break_off(too_big)
            return False
        return True

    def _break_off(self, failure: MotiongenError) -> None:
        """End it here, and at the server where that has it."""
        if self._line is Line.OPEN:
            number = self._unanswered.first(self._next_seq)
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
        wished = [(event, False) for event in self._wishes.events_from(self._offset)]
        held = [(event, is_kept) for event, is_kept in self._unanswered.take_all() if self._is_asked(event)]
        numbers = {}
        passed = EventRefused("a constraint", "FAILED_PRECONDITION", "FRAME_COMMITTED", LOST_MEANWHILE)
        for event, is_kept in (*wished, *held):
            self._say_as_frames(event)
            if shifted(event, self._offset) is None:
                continue
            self._reached.refuse(passed_targets(event, self._offset), passed)
            numbers[event.event_seq] = self._next_seq
            event.session, event.event_seq = self.handle, self._next_seq
            self._unanswered.add(event, is_kept=is_kept)
            self._next_seq += 1
        self._edits.renumber(numbers)
        self._reached.refuse(self._wishes.passed_at(self._offset), passed)
        self._wishes.take_reopening(self._offset, opened.placements)
        self._send_unanswered()
        if self._failure is not None:
            return
        told = Reopened(self._offset, self._reason)
        self.reopenings = (*self.reopenings, told)
        _log.warning("session %d was opened anew at frame %d: %s", self.handle, told.frame, told.reason)
        call_back(self.on_reopened, told)

    def _is_asked(self, event: session_pb2.SessionEvent) -> bool:
        """Whether the application asked for it: what was said of its wishes when it was last opened anew was not."""
        return event.HasField("close") or self._edits.find(event.event_seq) is not None
