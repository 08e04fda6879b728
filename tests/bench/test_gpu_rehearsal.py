"""The rehearsal of a GPU plays a crowd to its end, and everybody gets frames and answers."""

from __future__ import annotations

from tests.bench.gpu_rehearsal import rehearse


def test_few_characters_miss_nothing() -> None:
    found = rehearse(20, slower=0.1, max_rows=8)
    assert found.missed == 0.0
    assert found.latencies_s
    assert found.refused == found.broken == 0
