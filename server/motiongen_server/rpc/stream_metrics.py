"""StreamMetrics: what the streams count for the metrics."""

from __future__ import annotations

from typing import Protocol


class StreamMetrics(Protocol):
    """Told by the streams, on the event loop."""

    def reject(self, reason: str) -> None:
        """A session was refused for want of room."""
        ...

    def end_clip(self, code: str, seconds: float, num_samples: int) -> None:
        """A call for a clip has ended with a status, after so long."""
        ...

    def count_resume(self, how: str) -> None:
        """A session whose transport was lost was resumed, or refused, or has expired: then nobody came back.

        Or it was let go, since memory ran short while it waited for its client.
        """
        ...

    def count_snapshot(self, what: str) -> None:
        """A snapshot of a session was written, or fenced, since another server holds it, or lost."""
        ...

    def give_up_on_reader(self) -> None:
        """The sessions of a stream were closed because its client does not read."""
        ...

    def drop_frames(self, count: int) -> None:
        """Frames were taken out of a stream's queue before they were sent."""
        ...


class NoStreamMetrics:
    """Counts nothing: for streams that nobody watches."""

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
