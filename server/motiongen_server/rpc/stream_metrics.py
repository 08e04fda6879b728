"""StreamMetrics: the events that streams, clips and snapshots report to the metrics."""

from __future__ import annotations

from typing import Protocol


class StreamMetrics(Protocol):
    """Called on the event loop."""

    def reject(self, reason: str) -> None:
        """A session was refused for lack of room."""
        ...

    def end_clip(self, code: str, seconds: float, num_samples: int) -> None:
        """A clip call has ended with a status, after that many seconds."""
        ...

    def count_resume(self, how: str) -> None:
        """What became of a session whose connection was lost. how: "resumed", "taken_over" from another server,
        "refused", "expired" since its client did not come back, or "let_go" since memory ran short meanwhile.
        """
        ...

    def count_snapshot(self, what: str) -> None:
        """A session's snapshot was "written", or "lost", or "fenced" since another server holds the session."""
        ...

    def give_up_on_reader(self) -> None:
        """The sessions of a stream were closed because its client does not read."""
        ...

    def drop_frames(self, count: int) -> None:
        """Frames were removed from a stream's queue before they were sent."""
        ...


class NoStreamMetrics:
    """Counts nothing."""

    def reject(self, reason: str) -> None:
        """As in StreamMetrics."""

    def end_clip(self, code: str, seconds: float, num_samples: int) -> None:
        """As in StreamMetrics."""

    def count_resume(self, how: str) -> None:
        """As in StreamMetrics."""

    def count_snapshot(self, what: str) -> None:
        """As in StreamMetrics."""

    def give_up_on_reader(self) -> None:
        """As in StreamMetrics."""

    def drop_frames(self, count: int) -> None:
        """As in StreamMetrics."""
