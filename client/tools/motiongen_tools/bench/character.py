"""One character as its client sees it: playback by arithmetic, and edits that await their effect.

It has no task, no timer and no frame data. When a frame is due follows from when playback began; whether it was there
in time is found out when the next frames arrive. A character that has nothing to show holds its pose for whole frame
times, as a game's loop would, and then plays on from there, so everything after it is due that much later.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_tools.bench.recorder import ANSWER, EVENT, LATENESS, OPEN, SCREEN, SLACK, Recorder
from motiongen_tools.bench.schedule import CharacterPlan, Phases

START_GRACE_S = 1.0  # a character that has shown nothing this long after its intended open misses frames
_JITTER_S = 0.02  # how long after a frame is due a game's loop asks for it, at most
_JITTER_PERIOD = 1021  # prime, so that characters and frames do not fall into step

_CONTINUE = session_pb2.PLAN_CAUSE_CONTINUE


@dataclass(slots=True)
class PendingEdit:
    """An edit that was sent, until its outcome and its first changed frame have arrived, in either order.

    first_frame: the first that it changes, once a plan has named it.
    """

    intended_s: float
    first_frame: int | None = None
    answered: bool = False
    changed: bool = False


@dataclass(slots=True)
class Showing:
    """An edit whose first changed frame has arrived and has not been shown yet."""

    intended_s: float
    frame: int
    arrived_s: float


class Character:
    """Playback and records of one character. All times are seconds from the start of the run."""

    __slots__ = (
        "_due_from_s",
        "_edits",
        "_epoch_s",
        "_frame_s",
        "_group",
        "_jitter",
        "_phases",
        "_plan_number",
        "_recorder",
        "_showing",
        "_shown_to",
        "buffered_to",
        "committed_to",
        "ended",
        "handle",
        "missed",
        "next_seq",
        "open_sent",
        "opened",
        "plan",
        "started",
    )  # fmt: skip

    def __init__(
        self,
        handle: int,
        plan: CharacterPlan,
        group: str,
        *,
        fps: int,
        jitter: tuple[float, ...],
        phases: Phases,
        recorder: Recorder,
    ) -> None:
        self.handle = handle
        self.plan = plan
        self._group = group
        self._frame_s = 1 / fps
        self._jitter = jitter
        self._phases = phases
        self._recorder = recorder
        self.open_sent = self.opened = self.started = self.ended = False
        self.next_seq = 1
        self.buffered_to = self.committed_to = 0
        self.missed = 0
        self._plan_number = 0
        self._epoch_s = 0.0  # when frame 0 was due; shifted by the time that poses were held
        self._shown_to = 0  # frames below it have been shown, even if they came again later
        self._due_from_s = plan.open_s + START_GRACE_S
        self._edits: dict[int, PendingEdit] = {}
        self._showing: list[Showing] = []

    @property
    def is_live(self) -> bool:
        """Whether events may be sent to it."""
        return self.open_sent and not self.ended

    @property
    def is_playing(self) -> bool:
        return self.started and not self.ended

    # ---- sending

    def take_seq(self, intended_s: float | None = None) -> int:
        """The number of the next event. With intended_s, it is an edit whose latencies are recorded."""
        seq = self.next_seq
        self.next_seq += 1
        if intended_s is not None:
            self._edits[seq] = PendingEdit(intended_s)
        return seq

    def playhead(self, now_s: float) -> int:
        """The frame being shown."""
        return max(min(int((now_s - self._epoch_s) / self._frame_s), self.buffered_to - 1), 0)

    def held_now(self, now_s: float) -> int:
        """Frame times, up to now, for which a pose has been held and not yet counted."""
        return max(int((now_s - self._epoch_s) / self._frame_s) - self.buffered_to + 1, 0)

    # ---- receiving

    def take_opened(self) -> None:
        self.opened = True

    def take_notice(self, notice: session_pb2.PlanNotice, now_s: float) -> None:
        """Drop what the plan replaces, and note which edits it contains."""
        self._plan_number = notice.plan
        counts = self._recorder.counts
        counts["plans"] += 1
        if notice.cause != _CONTINUE:
            counts["replans"] += 1
        if notice.valid_from < self.buffered_to:
            counts["frames_superseded"] += self.buffered_to - notice.valid_from
            if self.started:
                self._shown_to = self.playhead(now_s) + 1
                if notice.valid_from < self._shown_to:
                    counts["shown_frames_replaced"] += 1
            self.buffered_to = notice.valid_from
        for seq in notice.event_seqs:
            edit = self._edits.get(seq)
            if edit is not None:
                edit.first_frame = notice.valid_from

    def take_chunk(self, chunk: motion_pb2.FrameChunk, now_s: float) -> None:
        """Take new frames, and count those that were not there when they were due."""
        first, end = chunk.first_frame, chunk.first_frame + chunk.frame_count
        if chunk.plan != self._plan_number or first != self.buffered_to:
            self._recorder.counts["protocol_breaches"] += 1  # it is of another plan, or leaves a gap, or overlaps
            if chunk.plan != self._plan_number:
                return
        self._recorder.add("frames", self._group, now_s, chunk.frame_count)
        if not self.started:
            self._start(first, now_s)
        needed = max(first, self._shown_to)
        if needed < end:
            self._meet_deadline(needed, now_s)
        self.buffered_to = end
        self.committed_to = chunk.committed_to
        if self._edits:
            self._find_changed(end, now_s)

    def take_outcome(self, outcome: session_pb2.EditOutcome, now_s: float) -> None:
        """Take the answer to an edit. The stream counts the refusals."""
        edit = self._edits.get(outcome.event_seq)
        if edit is None:
            return
        self._record(ANSWER, edit.intended_s, now_s)
        edit.answered = True
        counts = self._recorder.counts
        if outcome.code:
            del self._edits[outcome.event_seq]
        elif not outcome.HasField("effective_frame"):
            counts["edits_that_changed_nothing"] += 1
            del self._edits[outcome.event_seq]
        elif edit.changed:
            del self._edits[outcome.event_seq]
        elif (
            edit.first_frame is None
        ):  # it is beyond everything planned: when its frames come says nothing about the server
            counts["edits_beyond_the_plan"] += 1
            del self._edits[outcome.event_seq]

    def look(self, now_s: float) -> None:
        """Record the edits that are on screen by now. Can be called at any time: the exact moment is computed."""
        if self._showing:
            playhead = self.playhead(now_s)
            self._showing = [showing for showing in self._showing if not self._has_shown(showing, playhead, now_s)]

    def end(self, now_s: float, *, as_planned: bool) -> None:
        """End the session, or the run. as_planned False: it keeps missing frames until its planned close."""
        if self.ended:
            return
        self.ended = True
        if not self.open_sent:
            return
        self.look(now_s)
        end_s = now_s if as_planned else min(self.plan.close_s, self._phases.end_s)
        self._count_missed(self._due_s(self.buffered_to) if self.started else self._due_from_s, end_s)
        self._recorder.add_span("due", self._group, self._due_from_s, end_s, 1 / self._frame_s)
        if not self.started:
            self._recorder.counts["characters_without_a_frame"] += 1
            self._recorder.record(OPEN, self._group, end_s - self.plan.open_s)  # it has waited at least this long

    def give_up_edits(self, now_s: float) -> None:
        """When the run ends, record how long edits have waited so far: omitting them would flatter the server."""
        for edit in self._edits.values():
            if edit.changed:
                continue
            if self._phases.measure_from_s <= edit.intended_s < self._phases.measure_to_s:
                self._recorder.counts["edits_unanswered"] += 1
                self._record(EVENT, edit.intended_s, now_s)
        self._edits.clear()

    def drop_edits(self) -> None:
        """Forget edits of a character that leaves as planned before they could be answered."""
        cut_off = sum(not edit.changed for edit in self._edits.values())
        if cut_off:
            self._recorder.counts["edits_cut_off_by_a_close"] += cut_off
        self._edits.clear()

    def refused(self) -> None:
        """Note that the server refused to open it."""
        self.ended = True

    # ---- arithmetic

    def _due_s(self, frame: int) -> float:
        """When the game's loop asks for a frame."""
        jitter = self._jitter[(self.handle * 31 + frame) % _JITTER_PERIOD]
        return self._epoch_s + frame * self._frame_s + jitter

    def _start(self, first: int, now_s: float) -> None:
        self.started = True
        self._recorder.record(OPEN, self._group, now_s - self.plan.open_s)
        self._count_missed(self._due_from_s, now_s)
        self._due_from_s = min(self._due_from_s, now_s)
        self._epoch_s = now_s - first * self._frame_s
        self._shown_to = first

    def _meet_deadline(self, frame: int, now_s: float) -> None:
        due_s = self._due_s(frame)
        in_window = self._phases.measure_from_s <= now_s < self._phases.measure_to_s
        if in_window:
            self._recorder.record(LATENESS, self._group, max(now_s - due_s, 0.0))
            self._recorder.record(SLACK, self._group, max(due_s - now_s, 0.0))
        if now_s > due_s:
            self.look(now_s)
            if in_window:
                self._recorder.counts["late_chunks"] += 1
            held = self._count_missed(due_s, now_s)
            self.missed += held
            self._epoch_s += held * self._frame_s

    def _count_missed(self, due_s: float, now_s: float) -> int:
        """Whole frame times from due_s until now without anything new to show; counts as one underrun."""
        if now_s <= due_s:
            return 0
        held = math.floor((now_s - due_s) / self._frame_s) + 1
        self._recorder.add("underruns", self._group, due_s)
        for number in range(held):
            self._recorder.add("missed", self._group, due_s + number * self._frame_s)
        return held

    def _find_changed(self, end: int, now_s: float) -> None:
        for seq, edit in list(self._edits.items()):
            if edit.changed or edit.first_frame is None or edit.first_frame >= end:
                continue
            edit.changed = True
            self._record(EVENT, edit.intended_s, now_s)
            self._showing.append(Showing(edit.intended_s, edit.first_frame, now_s))
            if edit.answered:
                del self._edits[seq]

    def _has_shown(self, showing: Showing, playhead: int, now_s: float) -> bool:
        due_s = max(self._due_s(showing.frame), showing.arrived_s)
        if playhead < showing.frame or due_s > now_s:
            return False
        self._record(SCREEN, showing.intended_s, due_s)
        return True

    def _record(self, what: str, intended_s: float, now_s: float) -> None:
        if self._phases.measure_from_s <= intended_s < self._phases.measure_to_s:
            self._recorder.record(what, self._group, now_s - intended_s)


def make_jitter() -> tuple[float, ...]:
    """0 to 20 ms, by a low-discrepancy sequence: the same in every run."""
    golden = (math.sqrt(5) - 1) / 2
    return tuple(_JITTER_S * (number * golden % 1.0) for number in range(_JITTER_PERIOD))
