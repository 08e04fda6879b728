"""Feed: finds the frames of a character that are new, or that a new plan replaced."""

from __future__ import annotations

from motiongen_client.motion import Float32
from motiongen_client.playback import Playback


class Feed:
    """Watches a playback. A frame that was replaced is recognised because its array is another object."""

    def __init__(self, playback: Playback) -> None:
        self._playback = playback
        self._first = playback.playhead
        self._rows: list[Float32] = []
        self._plan = playback.plan

    def changed_from(self) -> int | None:
        """The first frame that was added or replaced since the last call; None if there is none."""
        playback = self._playback
        end = self._first + len(self._rows)
        if playback.plan == self._plan and playback.buffered_to == end:
            return None
        self._plan = playback.plan
        first = max(playback.playhead, playback.first_kept)
        rows = playback.held_rows(first, playback.buffered_to)
        changed = end
        for frame in range(max(first, self._first), min(end, first + len(rows))):
            if rows[frame - first] is not self._rows[frame - self._first]:
                changed = frame
                break
        self._first, self._rows = first, rows
        return min(changed, first + len(rows))
