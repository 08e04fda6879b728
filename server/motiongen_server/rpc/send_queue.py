"""SendQueue: what one stream still has to send, in order, without superseded frames."""

from __future__ import annotations

from collections import deque
from typing import TypeAlias

from motiongen_server.engine.types import Chunk, Closed, CloseReason, Float32Array, Opened, Outcome, Output, PlanNotice

UPDATE_OVERHEAD_BYTES = 64
PLACEMENT_BYTES = 64
EVENT_SEQ_BYTES = 10
"""The most that a placement, and an event's number in a plan, take on the wire."""
MAX_RUN_FRAMES = 80
"""Frames that one update may carry: the longest look-ahead by default."""


class Run:
    """Neighbouring chunks of one session and plan, to be sent as one.

    parts: their rows, (T, row_width) float32 each, in order. fixed: another output of the session was queued since, so
    later frames must not join. coding: how to encode them; None: plainly. num_bytes: the most that the run takes on the
    wire; 0 when nothing is left of it. num_excess: how many of its frames, the last ones, are beyond a look-ahead.
    """

    __slots__ = (
        "applied_seq", "coding", "committed_to", "first_frame", "fixed", "handle", "num_bytes", "num_excess",
        "num_frames", "parts", "plan", "row_bytes",
    )  # fmt: skip

    def __init__(self, chunk: Chunk, applied_seq: int, coding: object) -> None:
        rows = chunk.rows
        self.handle = chunk.session.handle
        self.plan = chunk.plan
        self.first_frame = chunk.first_frame
        self.num_frames = len(rows)
        self.committed_to = chunk.committed_to
        self.parts: list[Float32Array] = [rows]
        self.row_bytes = rows[:1].nbytes
        self.num_bytes = UPDATE_OVERHEAD_BYTES + rows.nbytes
        self.applied_seq = applied_seq
        self.coding = coding
        self.fixed = False
        self.num_excess = 0

    @property
    def excess_bytes(self) -> int:
        """Of num_bytes, those of the frames beyond a look-ahead."""
        return self.num_bytes if self.num_excess == self.num_frames else self.num_excess * self.row_bytes

    def joins(self, chunk: Chunk) -> bool:
        """Add a chunk if it continues the run; returns whether it does."""
        num_frames = self.num_frames + len(chunk.rows)
        follows = chunk.plan == self.plan and chunk.first_frame == self.first_frame + self.num_frames
        if self.fixed or not follows or num_frames > MAX_RUN_FRAMES:
            return False
        self.parts.append(chunk.rows)
        self.num_bytes += chunk.rows.nbytes
        self.num_frames = num_frames
        self.committed_to = chunk.committed_to
        return True

    def cut(self, end_frame: int) -> int:
        """Drop the frames from end_frame on; returns how many were dropped."""
        dropped = min(self.num_frames, max(0, self.first_frame + self.num_frames - end_frame))
        left = self.num_frames - dropped
        if dropped:
            self.fixed = True
            self.num_frames = left
            self.num_excess = max(0, self.num_excess - dropped)
            kept = []
            for part in self.parts:
                kept.append(part[:left])
                left -= len(kept[-1])
            self.parts = [part for part in kept if len(part)]
            self.num_bytes = UPDATE_OVERHEAD_BYTES + sum(part.nbytes for part in self.parts) if self.parts else 0
        return dropped


Said: TypeAlias = tuple[Output, int]
"""An output other than frames, and the session's applied_seq at that time."""


class SendQueue:
    """Outputs that wait to be written. A plan notice removes the frames it replaces that have not been sent yet.

    num_bytes: of everything that waits; excess_bytes: the same without a look-ahead of frames of each open session. A
    client is owed those: a short stop of one that carries many sessions, or the opening of many at once, leaves as much
    unread as the server itself has chosen to send ahead. Frames of a session that is over count in full, otherwise a
    client could have a look-ahead kept for each of any number of sessions.
    """

    __slots__ = ("_runs", "_waiting", "dropped_frames", "excess_bytes", "num_bytes")

    def __init__(self) -> None:
        self._waiting: deque[Run | Said] = deque()
        self._runs: dict[int, list[Run]] = {}  # those that wait, by handle, in order; few for each session
        self.num_bytes = 0
        self.excess_bytes = 0
        self.dropped_frames = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def put_chunk(self, chunk: Chunk, applied_seq: int, coding: object = None, lookahead: int = 0) -> None:
        """Add frames to the run that they continue, or at the end.

        applied_seq, coding: the session's at present. lookahead: how many of its frames may wait without being excess.
        """
        runs = self._runs.get(chunk.session.handle)
        before = (0, 0) if runs is None else (runs[-1].num_bytes, runs[-1].excess_bytes)
        if runs is not None and runs[-1].joins(chunk):
            run = runs[-1]
        else:
            run, before = Run(chunk, applied_seq, coding), (0, 0)
            if runs is None:
                self._runs[run.handle] = runs = [run]
            else:
                runs.append(run)
            self._waiting.append(run)
        num_frames = run.num_frames if len(runs) == 1 else sum(each.num_frames for each in runs)
        if num_frames > lookahead:
            run.num_excess += min(len(chunk.rows), num_frames - lookahead)
        self._count(run, *before)

    def _count(self, run: Run, num_bytes: int, excess_bytes: int) -> None:
        """Count how a run has changed. num_bytes, excess_bytes: its own, until then."""
        self.num_bytes += run.num_bytes - num_bytes
        self.excess_bytes += run.excess_bytes - excess_bytes

    def put(self, output: Output, applied_seq: int) -> None:
        """Add any other output at the end. applied_seq: the session's as of this output, to be sent with it."""
        handle = output.session.handle
        runs = self._runs.get(handle)
        if runs is not None:
            runs[-1].fixed = True
            if isinstance(output, PlanNotice):
                self._supersede(runs, output.valid_from)
            elif isinstance(output, Closed):
                if output.reason is CloseReason.TAKEN_OVER:  # what its client lacks is sent where it goes on
                    self._supersede(runs, 0)
                self._leave(runs)
                del self._runs[handle]  # a plan of the handle's next session must not remove these frames
        self._waiting.append((output, applied_seq))
        size = size_of(output)
        self.num_bytes += size
        self.excess_bytes += size

    def _supersede(self, runs: list[Run], valid_from: int) -> None:
        for run in runs:
            before = run.num_bytes, run.excess_bytes
            self.dropped_frames += run.cut(valid_from)
            self._count(run, *before)

    def _leave(self, runs: list[Run]) -> None:
        """The session of these runs is over: nothing of them is a look-ahead any more."""
        for run in runs:
            self.excess_bytes += run.num_bytes - run.excess_bytes
            run.num_excess = run.num_frames

    def drop_frames(self) -> None:
        """Remove all frames of open sessions, since the client does not read them."""
        for runs in self._runs.values():
            self._supersede(runs, 0)

    def clear(self) -> None:
        """Remove everything: nothing will be sent."""
        self._waiting.clear()
        self._runs.clear()
        self.num_bytes = self.excess_bytes = 0

    def take(self, max_bytes: int) -> list[Run | Said]:
        """Remove and return the oldest updates that fit into max_bytes, at least one if there is any."""
        taken: list[Run | Said] = []
        left = max_bytes
        waiting = self._waiting
        while waiting:
            item = waiting[0]
            size = item.num_bytes if isinstance(item, Run) else size_of(item[0])
            if taken and size > left:
                break
            waiting.popleft()
            left -= size
            self.excess_bytes -= item.excess_bytes if isinstance(item, Run) else size
            if isinstance(item, Run):
                self._forget(item)
                if not item.parts:
                    continue
            taken.append(item)
        self.num_bytes -= max_bytes - left
        return taken

    def _forget(self, run: Run) -> None:
        runs = self._runs.get(run.handle)
        if runs is not None and runs[0] is run:
            if len(runs) > 1:
                del runs[0]
            else:
                del self._runs[run.handle]


def size_of(output: Output) -> int:
    """Roughly how many bytes an output without frames takes on the wire."""
    size = UPDATE_OVERHEAD_BYTES
    if isinstance(output, PlanNotice):
        return size + EVENT_SEQ_BYTES * len(output.event_seqs)
    if isinstance(output, Outcome):
        size += len(output.reason + output.message + output.field + output.allowed)
    if isinstance(output, Outcome | Opened):
        size += PLACEMENT_BYTES * len(output.placements)
        for each in output.warnings:
            size += UPDATE_OVERHEAD_BYTES + len(each.reason + each.message + each.field)
    return size
