"""How a session goes on when the line to its server was lost.

The stream calls `interrupt`, and `reattach` once there is another call. The session then resumes where it is. Where the
server cannot go on with it, it is opened anew: the last frames held are the new session's history, its frame 0 is the
next of ours, and it is told all that the old one had been told.
"""

from __future__ import annotations

import asyncio
import enum
import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from motiongen.v1 import session_pb2
from motiongen_client import convert
from motiongen_client.backoff import Backoff
from motiongen_client.callbacks import call_back
from motiongen_client.carrier import Carrier
from motiongen_client.direction import PRESENT_PROMPT_ID, Direction
from motiongen_client.edit import LOST_MEANWHILE, Edit
from motiongen_client.errors import EventRefused, MotiongenError, ProtocolViolation, SessionEnded, UnknownName
from motiongen_client.frame_shift import shifted
from motiongen_client.motion import Motion
from motiongen_client.types import Catalog, Opened, Priority, Reopened, SessionOptions, StartPose
from motiongen_client.wishes import Wishes

_log = logging.getLogger(__name__)

_WORTH_WAITING = frozenset({"RESOURCE_EXHAUSTED", "UNAVAILABLE"})


class Line(enum.Enum):
    """Whether a session and the server hear each other. OPENING, REOPENING and RESUMING wait for a SessionOpened."""

    OPENING = enum.auto()
    OPEN = enum.auto()
    LOST = enum.auto()
    RESUMING = enum.auto()
    REOPENING = enum.auto()


class Recovery(Direction):
    """The part of a `Session` that finds its way back to a server.

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
        self._num_resumes = 0
        self._has_reported = False  # of the present session on the server
        self._patience = Backoff()
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
        sent = self._send_edit("the change of options", session_pb2.SessionEvent(set_options=message))
        # Others may have been accepted by then: to those of that moment.
        sent.when_accepted(lambda: setattr(self, "_options", replace(self._options, **given)))
        return sent

    # ---- for the stream

    def interrupt(self) -> None:
        """The line is lost; `reattach` follows, or `fail`."""
        if self._line is not Line.OPENING:
            self._line = Line.LOST
            self._changed.set()  # who waits for an answer hears that none comes

    def reattach(self, catalog: Catalog) -> None:
        """There is another call to a server, which has this catalogue: go on there."""
        self._catalog = catalog
        if self._line is Line.OPENING:
            self._send_unanswered()
        elif self._token:
            self._resume()
        else:
            self._reopen(self._reason or "the server does not resume sessions")

    @property
    def is_away(self) -> bool:
        """Whether its line was lost, and the session has not gone on yet."""
        return self._line in (Line.LOST, Line.RESUMING, Line.REOPENING)

    @property
    def is_waiting(self) -> bool:
        """Whether it lives, and no server is asked to go on with it at present."""
        return self._line is Line.LOST and self._failure is None

    def wait_for_room(self, refusal: EventRefused) -> None:
        """The server has no room for it at present, nor has another: ask again when it says so."""
        self._later(self._resume if self._token else self._reopen_again, refusal.retry_after_s or 0.0)

    def move(self, handle: int, carrier: Carrier, catalog: Catalog, *, now: bool) -> None:
        """Another stream carries it from now on, by this handle. now: it has a call, so its server is asked at once."""
        self.handle, self._carrier = handle, carrier
        for event in self._unanswered.values():
            event.session = handle
        if now:
            self.reattach(catalog)

    # ---- what is said

    @property
    def _is_attached(self) -> bool:
        return self._line in (Line.OPENING, Line.OPEN)

    def _resume(self) -> None:
        self._line = Line.RESUMING
        self._attempt += 1
        point = session_pb2.ResumePoint(
            next_frame=self.playback.received_to - self._offset,
            plan=self.playback.plan,
            answered_seq=self._answered_seq,
            attempt=self._attempt,
            playhead=max(self.playback.playhead - self._offset, 0),
            committed_to=max(self.playback.committed_to - self._offset, 0),
        )
        self._send_opening(session_pb2.OpenSession(resume_token=self._token, resume_point=point))

    def _reopen(self, reason: str) -> None:
        """Open a session that goes on from the last frame that is held."""
        self._line, self._token, self._attempt, self._reason = Line.REOPENING, "", 0, reason
        self.durable_seq = 0
        self._has_reported = False
        self._set_durable(False)
        frame = self.playback.buffered_to
        options = replace(self._options, seed=self.opened.seed, model_id=self.opened.model_id)
        if frame > self.playback.first_kept:
            options = replace(options, prior=self._prior(frame), start=StartPose())
        self.playback.restart(frame)
        self._offset = frame
        prompts = self._wishes.prompts_from(frame, self._catalog.limits.max_prompts)
        constraints = self._wishes.constraints_from(frame)
        lasting = [span for span in prompts if span.prompt_id != PRESENT_PROMPT_ID and not span.end_frame]
        self._scheduled_prompts = {span.prompt_id: span.start_frame + frame for span in lasting}
        self._send_opening(convert.open_session(options, prompts, constraints))

    def _prior(self, end_frame: int) -> Motion:
        """The last frames held, as many as a window sees; where there are fewer, the first is repeated before them."""
        try:
            model = self._catalog.model(self.opened.model_id)
        except UnknownName:
            wanted = 1  # the server will say so
        else:
            patch = max(model.patch_frames, 1)
            asked = self._options.history_frames or model.default_history_frames
            most = max(self._catalog.limits.max_request_bytes * 9 // 10 // (4 * self.rig.own_width), 1)
            wanted = min(max(min(asked, most) // patch, 1) * patch, most)  # in a message that the server takes
        first = max(end_frame - wanted, self.playback.first_kept, self.playback.cut_before(end_frame) or 0)
        rows = self.playback.rows(first, end_frame)
        missing = wanted - len(rows)
        if missing > 0:
            rows = np.concatenate((np.repeat(rows[:1], missing, axis=0), rows))
        return Motion(self.rig, end_frame - wanted, rows)

    def _send_opening(self, opening: session_pb2.OpenSession) -> None:
        self._carrier.send(session_pb2.SessionEvent(session=self.handle, event_seq=1, open=opening))

    def _send_unanswered(self) -> None:
        """Say again what was not answered, with the numbers it has; the server drops what it has taken already."""
        for event in self._unanswered.values():
            self._transmit(event)

    # ---- what is heard

    def _set_durable(self, is_durable: bool) -> None:
        if is_durable != self.is_durable:
            self.is_durable = is_durable
            call_back(self.on_durability, is_durable)

    def _hear_reopened(self, opened: Opened, token: str) -> None:
        """The session goes on: as it was, or as a new one."""
        if self._line is Line.RESUMING:
            self._line = Line.OPEN
            self._num_resumes += 1
            self._send_unanswered()
        elif self._line is Line.REOPENING:
            self._go_on_anew(opened)
        else:
            raise ProtocolViolation("a session was opened that had not been asked for")
        self._token = token
        self._patience.reset()
        self._carrier.report_soon()

    def _go_on_anew(self, opened: Opened) -> None:
        known = {rig.rig_id: rig.own_width for rig in self._catalog.rigs}
        is_same = opened.rig_id == self.opened.rig_id and opened.outputs == self.opened.outputs
        if not is_same or known.get(opened.rig_id) != self.rig.own_width:
            self.fail(SessionEnded("model_unloaded", f"its rig, {self.opened.rig_id}, is not served any more"))
            return
        self._line, self.opened = Line.OPEN, opened
        waiting = [*self._wishes.events_from(self._offset), *self._unanswered.values()]
        for event in waiting:
            self._say_as_frames(event)
        self._unanswered.clear()
        self._next_seq = 2
        numbers = {}
        for event in waiting:
            if shifted(event, self._offset) is None:
                continue
            numbers[event.event_seq] = self._next_seq
            event.session, event.event_seq = self.handle, self._next_seq
            self._unanswered[self._next_seq] = event
            self._next_seq += 1
        self._edits.renumber(numbers)
        passed = EventRefused("a constraint", "FAILED_PRECONDITION", "FRAME_COMMITTED", LOST_MEANWHILE)
        self._reached.refuse(self._wishes.passed_at(self._offset), passed)
        self._send_unanswered()
        told = Reopened(self._offset, self._reason)
        self.reopenings = (*self.reopenings, told)
        _log.warning("session %d was opened anew at frame %d: %s", self.handle, told.frame, told.reason)
        call_back(self.on_reopened, told)

    def _hear_refused_opening(self, refusal: EventRefused) -> None:
        if self._line is Line.OPENING:
            self.fail(refusal)
        elif refusal.code in _WORTH_WAITING:
            self._line = Line.LOST
            if not self._carrier.move_elsewhere(self.handle, refusal):
                self.wait_for_room(refusal)
        elif self._line is Line.RESUMING:
            self._reopen(f"the server did not keep it ({refusal.reason})")
        else:
            self.fail(refusal)

    def _lose(self, reason: str) -> None:
        """The server has ended the session as it goes away, or has lost it: go on elsewhere, or open it anew."""
        self._line, self._reason = Line.LOST, reason
        self._changed.set()
        if not self.is_durable:
            self._token = ""
        if not self._carrier.draining:  # else the stream ends soon, and the next one reattaches
            self._later(self._resume if self._token else self._reopen_again, 0.0)

    def _reopen_again(self) -> None:
        self._reopen(self._reason)

    def _later(self, act: Callable[[], None], at_least_s: float) -> None:
        """Act when it is worth another attempt, unless the line has been lost or mended meanwhile."""
        call = self._carrier.call_number

        def due() -> None:
            if self._line is Line.LOST and self._failure is None and self._carrier.call_number == call:
                act()

        asyncio.get_running_loop().call_later(self._patience.next_s(at_least_s), due)
