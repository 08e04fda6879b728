"""The simulation of a GPU plays a crowd to its end; all characters get frames and answers."""

from __future__ import annotations

from tests.bench.gpu_rehearsal import rehearse


def test_small_crowd_misses_no_frames() -> None:
    found = rehearse(20, slower=0.1, max_rows=8)
    assert found.missed == 0.0
    assert found.latencies_s
    assert found.refused == found.broken == 0
