"""Playback of a character that is not drawn: when its frames came, when they were due, how long it stood still."""

from __future__ import annotations

from dataclasses import dataclass, field

from motiongen_server.engine.types import Chunk, Code, Outcome, Output, PlanNotice


@dataclass(slots=True)
class Playback:
    """Plays at fps from the arrival of the first frame; stands still while the next frame is missing.

    Times are those of the engine's deliveries. latencies_s: of edits, from their scheduled time to the arrival of the
    first frame that they changed; shown_after_s: to the time at which it was due to be shown. broken: plans that
    replaced frames which had been shown or were committed.
    """

    fps: int
    started_at: float | None = None
    held_s: float = 0.0
    buffered_to: int = 0
    committed_to: int = 0
    latencies_s: list[float] = field(default_factory=list)
    shown_after_s: list[float] = field(default_factory=list)
    num_refused: int = 0
    let_in: bool = True
    broken: int = 0
    stalls: list[tuple[float, float]] = field(default_factory=list)
    _meant_at: dict[int, float] = field(default_factory=dict)
    _effective: dict[int, int] = field(default_factory=dict)

    def due_at(self, frame: int) -> float:
        """When a frame is due to be shown."""
        assert self.started_at is not None
        return self.started_at + self.held_s + frame / self.fps

    def frame_at(self, now: float) -> int:
        """The frame being shown."""
        if self.started_at is None:
            return 0
        return max(0, min(int((now - self.started_at - self.held_s) * self.fps), self.buffered_to - 1))

    def underruns(self) -> int:
        return len(self.stalls)

    def meant(self, event_seq: int, at: float) -> None:
        """Note the scheduled time of an edit."""
        self._meant_at[event_seq] = at

    def hear(self, output: Output, now: float) -> None:
        """Take any output of the engine for the session."""
        match output:
            case Chunk():
                self.receive(output, now)
            case PlanNotice():
                self.notice(output, now)
            case Outcome():
                self.answer(output)

    def notice(self, notice: PlanNotice, now: float) -> None:
        """Drop the frames that a new plan replaces."""
        shown_to = self.frame_at(now) + 1 if self.buffered_to else 0
        self.broken += notice.valid_from < max(self.committed_to, min(shown_to, self.buffered_to))
        self.buffered_to = min(self.buffered_to, notice.valid_from)

    def answer(self, outcome: Outcome) -> None:
        """Take an edit's outcome."""
        if outcome.code is not Code.OK:
            self.num_refused += 1
            self.let_in &= outcome.field != "open"
            self._meant_at.pop(outcome.event_seq, None)
        elif outcome.effective_frame is not None and outcome.event_seq in self._meant_at:
            self._effective[outcome.event_seq] = outcome.effective_frame

    def receive(self, chunk: Chunk, now: float) -> None:
        """Take frames."""
        end = chunk.first_frame + len(chunk.rows)
        if self.started_at is None:
            self.started_at = now
        elif now > (due_at := self.due_at(self.buffered_to)):
            self.stalls.append((due_at, now))
            self.held_s += now - due_at
        self.buffered_to, self.committed_to = end, max(self.committed_to, chunk.committed_to)
        for event_seq in [seq for seq, frame in self._effective.items() if frame < end]:
            shown_at, meant_at = self.due_at(self._effective.pop(event_seq)), self._meant_at.pop(event_seq)
            self.latencies_s.append(now - meant_at)
            self.shown_after_s.append(max(now, shown_at) - meant_at)

    def held_between(self, begin: float, end: float) -> float:
        """Seconds without a frame to show between `begin` and `end`; all of them if no frame ever came."""
        if self.started_at is None:
            return end - begin
        stalls = [(begin, self.started_at), *self.stalls, (self.due_at(self.buffered_to), end)]
        return sum(max(0.0, min(until, end) - max(since, begin)) for since, until in stalls)
