"""Processor time goes on with work and with sleeping, and not with waiting for the machine."""

from __future__ import annotations

from tests.bench.clocks import ProcessorClock


def test_sleeping_passes_the_time_without_taking_any() -> None:
    clock = ProcessorClock()
    before = clock.now()
    clock.sleep(3600.0)
    assert 3600.0 <= clock.now() - before < 3660.0
    clock.sleep(0.0)
    while clock.now() - before < 3600.01:  # work: ends only if it counts
        pass
