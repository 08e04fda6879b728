"""Feed: which frames of a character a browser has not seen, and from where a new plan replaced them."""

from __future__ import annotations

from motiongen_client.motion import Float32
from motiongen_client.playback import Playback


class Feed:
    """Watches a playback. `changed_from` tells what is new; frames that were replaced are other arrays than before."""

    def __init__(self, playback: Playback) -> None:
        self._playback = playback
        self._first = playback.playhead
        self._rows: list[Float32] = []
        self._plan = playback.plan

    def changed_from(self) -> int | None:
        """The first frame that came or was replaced since the last call; None where nothing did."""
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
