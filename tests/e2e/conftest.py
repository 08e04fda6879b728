"""For tests of lost connections: short delays, and a record of what every playback received."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest

from motiongen_client import (
    Playback,
    backoff,
    calls,
)
from tests.e2e.lost_line import Received


@pytest.fixture
def short_delays(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten the delays; growing delays are tested in the tests of `Backoff`."""
    monkeypatch.setattr(backoff, "LONGEST_DELAY_S", 0.1)
    monkeypatch.setattr(calls, "LAG_S", 0.05)


@pytest.fixture
def received(monkeypatch: pytest.MonkeyPatch) -> dict[Playback, Received]:
    """What each playback received. Committed frames that came again with other rows are recorded; frames that a later
    plan drops are removed.
    """
    heard: dict[Playback, Received] = defaultdict(Received)
    add_chunk, announce_plan = Playback.add_chunk, Playback.announce_plan

    def dropping(self: Playback, plan: int, valid_from: int, *, is_cut: bool = False) -> int:
        num_dropped, book = announce_plan(self, plan, valid_from, is_cut=is_cut), heard[self]
        for frame in [frame for frame in book.rows if frame >= self.buffered_to]:
            del book.rows[frame]
        return num_dropped

    def noting(self: Playback, plan: int, first_frame: int, rows: np.ndarray, committed_to: int) -> None:
        promised, book = self.committed_to, heard[self]
        add_chunk(self, plan, first_frame, rows, committed_to)
        for frame, row in enumerate(rows, first_frame):
            if frame < promised and frame in book.rows and not np.array_equal(book.rows[frame], row):
                book.changed.append(frame)
            book.rows[frame] = row

    monkeypatch.setattr(Playback, "add_chunk", noting)
    monkeypatch.setattr(Playback, "announce_plan", dropping)
    return heard
