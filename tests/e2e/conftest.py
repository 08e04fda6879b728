"""For tests of lost lines: short delays, and a record of what every playback was given."""

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
    """Delays that grow are the business of the tests of `Backoff`."""
    monkeypatch.setattr(backoff, "LONGEST_DELAY_S", 0.1)
    monkeypatch.setattr(calls, "LAG_S", 0.05)


@pytest.fixture
def received(monkeypatch: pytest.MonkeyPatch) -> dict[Playback, Received]:
    """By playback; committed frames that came again otherwise are noted."""
    heard: dict[Playback, Received] = defaultdict(Received)
    add_chunk = Playback.add_chunk

    def noting(self: Playback, plan: int, first_frame: int, rows: np.ndarray, committed_to: int) -> None:
        promised, book = self.committed_to, heard[self]
        add_chunk(self, plan, first_frame, rows, committed_to)
        for frame, row in enumerate(rows, first_frame):
            if frame < promised and frame in book.rows and not np.array_equal(book.rows[frame], row):
                book.changed.append(frame)
            book.rows[frame] = row

    monkeypatch.setattr(Playback, "add_chunk", noting)
    return heard
