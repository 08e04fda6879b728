"""StreamTracing: records a trace of each of a stream's windows when its first frames are written, or never will be."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

from motiongen_server.engine.types import PlanNotice
from motiongen_server.engine.types.tracing import WindowTrace
from motiongen_server.rpc.send_queue import Run, Said
from motiongen_server.rpc.sessions.entry import SessionEntry

RecordWindow = Callable[[WindowTrace], None]
"""Takes a window's trace; returns at once."""


class StreamTracing:
    """Windows by handle. When a session has a newer plan, an earlier one that is not being written never will be."""

    def __init__(self, record: RecordWindow, clock: Callable[[], float] = time.monotonic) -> None:
        self._record = record
        self._now = clock
        self._waiting: dict[int, tuple[PlanNotice, SessionEntry]] = {}
        self._taken: list[tuple[PlanNotice, SessionEntry]] = []

    def announce(self, notice: PlanNotice, entry: SessionEntry) -> None:
        """A plan was queued for the client."""
        self.end(entry.handle)
        if notice.timing is not None:
            self._waiting[entry.handle] = notice, entry

    def take(self, items: Iterable[Run | Said]) -> None:
        """These items are being written."""
        for item in items:
            if isinstance(item, Run) and item.handle in self._waiting and item.plan == self._plan_of(item.handle):
                self._taken.append(self._waiting.pop(item.handle))

    def note_written(self) -> None:
        """The items taken last have been written."""
        self._tell_taken(is_sent=True)

    def end(self, handle: int) -> None:
        """The frames of the plan that waits on that handle will not be written."""
        waiting = self._waiting.pop(handle, None)
        if waiting is not None:
            self._tell(*waiting, is_sent=False)

    def end_all(self) -> None:
        """Nothing more will be written, including what was being written."""
        self._tell_taken(is_sent=False)
        for handle in tuple(self._waiting):
            self.end(handle)

    def _plan_of(self, handle: int) -> int:
        return self._waiting[handle][0].plan

    def _tell_taken(self, is_sent: bool) -> None:
        taken, self._taken = self._taken, []
        for notice, entry in taken:
            self._tell(notice, entry, is_sent)

    def _tell(self, notice: PlanNotice, entry: SessionEntry, is_sent: bool) -> None:
        assert notice.timing is not None
        self._record(
            WindowTrace(
                timing=notice.timing,
                session="" if entry.opened is None else entry.opened.session_id,
                request_id=entry.request_id,
                model_id="" if entry.opened is None else entry.opened.model_id,
                plan=notice.plan,
                first_frame=notice.valid_from,
                cause=notice.cause,
                num_events=len(notice.event_seqs),
                sent_at=self._now(),
                is_sent=is_sent,
            )
        )
